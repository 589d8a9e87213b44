"""Plain recording tables: text and Parquet as typed blocks, headers, faulty values named."""
