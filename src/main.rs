//! The program `vlf`: arguments in, library calls, errors printed.

mod cli;

fn main() -> std::process::ExitCode {
    cli::run()
}
