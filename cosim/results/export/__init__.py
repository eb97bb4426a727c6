"""A run's log in formats of others: CSV, Parquet, MAT, MCAP, and ULog."""
