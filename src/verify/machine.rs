//! Where a measurement was made.

use serde::Serialize;

/// The computer, as far as the system tells.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Machine {
    /// Processor model; empty if unknown.
    pub processor: String,
    /// Processors the system lets this process use.
    pub processors: usize,
    /// `linux x86_64`.
    pub system: String,
    /// Load averages at the end; empty if unknown. Above the number of processors, times are too long.
    pub load: String,
    /// True for a build without optimisation of the release profile.
    pub debug_assertions: bool,
}

impl Machine {
    /// This one, now.
    pub fn here() -> Self {
        let read = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
        let load = read("/proc/loadavg");
        Self {
            processor: model(&read("/proc/cpuinfo")).to_owned(),
            processors: std::thread::available_parallelism().map_or(1, usize::from),
            system: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            load: load.split(' ').take(3).collect::<Vec<_>>().join(" "),
            debug_assertions: cfg!(debug_assertions),
        }
    }
}

/// The first processor's model name.
fn model(cpuinfo: &str) -> &str {
    cpuinfo
        .lines()
        .find_map(|line| line.strip_prefix("model name"))
        .and_then(|line| line.split_once(':'))
        .map_or("", |(_, name)| name.trim())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_model_is_read_from_cpuinfo() {
        assert_eq!(
            model("processor\t: 0\nmodel name\t: Some CPU @ 2 GHz\n"),
            "Some CPU @ 2 GHz"
        );
        assert_eq!(model(""), "");
    }
}
