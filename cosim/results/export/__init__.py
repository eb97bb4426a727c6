"""A run's log in formats of others: CSV, Parquet, MAT, MCAP, and ULog."""

from __future__ import annotations

# the file in a run's folder, the endings, and the module of each format
FILES = {
    "ulog": "flight.ulg",
    "mcap": "flight.mcap",
    "mat": "flight.mat",
    "csv": "flight.csv",
    "parquet": "flight.parquet",
}
ENDINGS = {"ulog": (".ulg", ".ulog")} | {name: (f".{name}",) for name in FILES if name != "ulog"}
MODULES = {"ulog": "ulog", "mcap": "mcap_file", "mat": "mat", "csv": "csv_file", "parquet": "parquet"}
LOG_ENDINGS = tuple(ending for endings in ENDINGS.values() for ending in endings)
