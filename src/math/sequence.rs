//! Low-discrepancy point sets and their mapping to directions.
