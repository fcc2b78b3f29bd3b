//! The process that reads cases, one after the other, and says how each ended.

use crate::case::Case;
use crate::corpus::seeds;
use crate::random::Random;
use rustix::time::{ClockId, clock_gettime};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::time::Duration;
use surflux::diagnostics::Diagnostics;
use surflux::stage::cloud::read_cloud;
use surflux::stage::validate::validate;
use surflux::stage::{self, Door, ReadSettings, process_peak_memory};

/// Where the case stands, a folder.
pub(crate) const FOLDER: &str = "SURFLUX_FUZZ_FOLDER";
pub(crate) const SEED: &str = "SURFLUX_FUZZ_CASES";
/// Number of the first case.
pub(crate) const FIRST: &str = "SURFLUX_FUZZ_CHILD_FIRST";

/// Processor time a case may take: the files are small.
pub(crate) const MOST_CPU: Duration = Duration::from_secs(5);

/// Memory in use while a case is read, bytes, the process's own included.
const MOST_MEMORY: u64 = 1 << 30;

#[test]
#[ignore = "started by the other test, in a process of its own"]
fn reads_cases() {
    let (Ok(folder), Ok(seed), Ok(first)) = (
        std::env::var(FOLDER),
        std::env::var(SEED),
        std::env::var(FIRST),
    ) else {
        return;
    };
    let folder = PathBuf::from(folder);
    let seed = seed.parse().expect("a seed");
    let first: u64 = first.parse().expect("the number of a case");
    let seeds = seeds();
    println!();
    for number in first.. {
        println!("begin {number}");
        let mut random = Random::new(seed, number);
        let case = Case::write(&seeds, &mut random, &folder).expect("written");
        // not everywhere: then the peak stays that of earlier cases
        let _ = std::fs::write("/proc/self/clear_refs", "5");
        let start = cpu_time();
        match catch_unwind(AssertUnwindSafe(|| read(&case, &mut random))) {
            Ok(true) => println!("read {number}"),
            Ok(false) => {}
            Err(panic) => {
                let text = panic.downcast_ref::<String>().cloned();
                let text = text.or_else(|| panic.downcast_ref::<&str>().map(|&t| t.to_owned()));
                println!("found {number} panic: {:?}", text.unwrap_or_default());
            }
        }
        let took = cpu_time().saturating_sub(start);
        if took > MOST_CPU {
            println!("found {number} it took {took:?}");
        }
        let peak = process_peak_memory("self").unwrap_or(0);
        if peak > MOST_MEMORY {
            println!("found {number} it took {} MiB", peak >> 20);
        }
    }
}

/// Read the case as a stage or a cloud, sometimes as both; true if the stage was read.
fn read(case: &Case, random: &mut Random) -> bool {
    let quiet = Diagnostics::default();
    if case.is_cloud || random.below(8) == 0 {
        // what is wrong is told in an error
        let _ = read_cloud(&case.damaged, glam::DVec3::ZERO, &quiet);
    }
    if random.below(8) == 0 {
        let _ = validate(&case.damaged, Door::Native, &quiet);
    }
    let settings = ReadSettings {
        time: case.time,
        ..ReadSettings::default()
    };
    let source = stage::open(&case.root, Door::Native, &quiet);
    let scene = source.and_then(|mut source| stage::read(&mut *source, &settings, &quiet));
    scene.is_ok()
}

/// Processor time of the whole process.
fn cpu_time() -> Duration {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    let seconds = u64::try_from(time.tv_sec).unwrap_or(0);
    Duration::from_secs(seconds) + Duration::from_nanos(u64::try_from(time.tv_nsec).unwrap_or(0))
}
