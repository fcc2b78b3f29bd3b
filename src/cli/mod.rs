//! The command line: arguments as typed → a job as meant.
