//! What work costs: the time that this process's threads computed, which other programs on the machine do not change.

/// A moment in processor time.
#[derive(Debug, Clone, Copy)]
pub struct Clock(f64);

impl Clock {
    /// Start measuring.
    pub fn start() -> Self {
        Self(now())
    }

    /// Seconds that all threads of this process have computed since; wall-clock seconds where the system does not tell.
    pub fn seconds(self) -> f64 {
        now() - self.0
    }
}

#[cfg(unix)]
fn now() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

#[cfg(not(unix))]
fn now() -> f64 {
    std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .map_or(0.0, |time| time.as_secs_f64())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::{Duration, Instant};

    #[test]
    fn work_counts() {
        let (clock, start) = (Clock::start(), Instant::now());
        let mut x = 0_u64;
        while start.elapsed() < Duration::from_millis(50) {
            x = std::hint::black_box(x + 1);
        }
        // Other programs may have had most of that time; other tests' threads count too.
        assert!(x > 0 && clock.seconds() > 0.001);
    }
}
