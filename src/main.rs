//! The `surflux` program: see [`surflux::cli`].

fn main() -> std::process::ExitCode {
    surflux::cli::main()
}
