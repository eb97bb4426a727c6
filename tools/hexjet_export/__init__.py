"""A controller as C and as FMUs, the vehicle as FMUs and SSP, and logs in formats beyond CSV and Parquet."""
