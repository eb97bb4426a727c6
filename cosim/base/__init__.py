"""What every room stands on: records, frames, files, errors."""
