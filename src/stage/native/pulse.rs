//! Signs of life of the thread that holds the stage. The crate may follow arcs that lead in circles without an end, and
//! nothing can stop it: who waits for its answer tells that from work by what it takes between one prim or layer and the
//! next, and gives up.

use openusd::sdf;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

/// How often the one who waits looks.
pub(super) const EVERY: Duration = Duration::from_millis(100);

/// Steps shorter than this are not looked at more closely.
const SHORT: Duration = Duration::from_millis(500);

/// Where a system does not tell the processor time of a thread, that much of the time that goes by counts: a thread may wait
/// for disks and other processes.
const SHARE_OF_TIME: f64 = 0.05;

/// What a step may take: from one prim or layer to the next.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    /// Processor time of any step; waiting for disks, or for others to leave the processor, is none.
    pub(super) cpu: Duration,
    /// Memory that the process may grow by, bytes.
    pub(super) memory: u64,
    /// Stack in use that is as good as all of it, bytes.
    pub(super) stack: u64,
}

/// Ten times what all steps of a shot of 4000 layers take together, 1.45 s of processor time.
const USUAL: Limits = Limits {
    cpu: Duration::from_secs(15),
    memory: 2 << 30,
    stack: super::STACK_BYTES as u64 / 2,
};

/// Processor time for each byte of a layer opened: reading text takes a tenth of it.
const NANOSECONDS_A_BYTE: u64 = 1000;

/// Memory for each byte of a layer opened.
const BYTES_A_BYTE: u64 = 32;

/// Processor time for each of many prims that are composed together.
const A_PRIM: Duration = Duration::from_millis(10);

/// Processor time for each layer, as the crate wires all anew.
const A_LAYER: Duration = Duration::from_millis(5);

/// What reading values may take: as long as 600 GB.
const READING: Duration = Duration::from_secs(1200);

/// What the thread tells.
#[derive(Debug)]
pub(super) struct Pulse {
    limits: Limits,
    steps: AtomicU64,
    /// Of the present step, on top of its limits: milliseconds and bytes.
    extra: (AtomicU64, AtomicU64),
    layers: AtomicU64,
    /// What it is about, if it is one prim.
    prim: Mutex<Option<sdf::Path>>,
    place: OnceLock<Place>,
    is_lost: AtomicBool,
}

/// Where the thread is found.
#[derive(Debug)]
struct Place {
    /// Its folder, where the system has one.
    folder: Option<PathBuf>,
    /// An address of its stack.
    address: usize,
}

/// What the thread had taken when a step was first seen.
#[derive(Debug)]
pub(super) struct Watch<'a> {
    pulse: &'a Pulse,
    step: u64,
    cpu: Duration,
    memory: u64,
    stack: Option<u64>,
}

impl Default for Pulse {
    fn default() -> Self {
        Self::new(USUAL)
    }
}

impl Pulse {
    fn new(limits: Limits) -> Self {
        Self {
            limits,
            steps: AtomicU64::new(0),
            extra: (AtomicU64::new(0), AtomicU64::new(0)),
            layers: AtomicU64::new(0),
            prim: Mutex::new(None),
            place: OnceLock::new(),
            is_lost: AtomicBool::new(false),
        }
    }

    /// The calling thread is the one to watch.
    pub(super) fn is_of_this_thread(&self) {
        let on_stack = 0_u8;
        let folder = std::fs::read_link("/proc/thread-self").ok();
        let place = Place {
            folder: folder.map(|folder| PathBuf::from("/proc").join(folder)),
            address: &raw const on_stack as usize,
        };
        // the first call counts
        let _ = self.place.set(place);
    }

    /// A layer of so many bytes was opened, for the first time.
    pub(super) fn layer(&self, bytes: usize) {
        let bytes = bytes as u64;
        self.layers.fetch_add(1, Ordering::Relaxed);
        let milliseconds = bytes * NANOSECONDS_A_BYTE / 1_000_000;
        self.extra.0.fetch_add(milliseconds, Ordering::Relaxed);
        let memory = bytes * BYTES_A_BYTE;
        self.extra.1.fetch_add(memory, Ordering::Relaxed);
        self.steps.fetch_add(1, Ordering::Relaxed);
    }

    /// Now the prim at `path` is composed.
    pub(super) fn prim(&self, path: &sdf::Path) {
        *self.prim.lock().unwrap_or_else(PoisonError::into_inner) = Some(path.clone());
        self.begin(A_PRIM);
    }

    /// Now `count` prims are composed together, or all that the stage has of something.
    pub(super) fn prims(&self, count: usize) {
        *self.prim.lock().unwrap_or_else(PoisonError::into_inner) = None;
        let count = u32::try_from(count).unwrap_or(u32::MAX);
        self.begin(A_PRIM.saturating_mul(count));
    }

    /// Now values are read, which takes as long as they are many.
    pub(super) fn values(&self) {
        self.begin(READING);
        self.extra.1.store(u64::MAX / 2, Ordering::Relaxed);
    }

    fn begin(&self, extra: Duration) {
        let layers = u32::try_from(self.layers.load(Ordering::Relaxed)).unwrap_or(u32::MAX);
        let extra = extra.saturating_add(A_LAYER.saturating_mul(layers));
        let milliseconds = u64::try_from(extra.as_millis()).unwrap_or(u64::MAX / 2);
        self.extra.0.store(milliseconds, Ordering::Relaxed);
        self.extra.1.store(0, Ordering::Relaxed);
        self.steps.fetch_add(1, Ordering::Relaxed);
    }

    /// Nobody waits for the thread any more.
    pub(super) fn give_up(&self) {
        self.is_lost.store(true, Ordering::Relaxed);
    }

    /// True if the thread is still busy with what was given up.
    pub(super) fn is_lost(&self) -> bool {
        self.is_lost.load(Ordering::Relaxed)
    }

    pub(super) fn watch(&self) -> Watch<'_> {
        Watch {
            pulse: self,
            step: self.steps.load(Ordering::Relaxed),
            cpu: self.cpu(Instant::now()),
            memory: resident_memory(),
            stack: None,
        }
    }

    fn subject(&self) -> String {
        let prim = self.prim.lock().unwrap_or_else(PoisonError::into_inner);
        prim.as_ref()
            .map_or_else(|| "the stage".to_owned(), |path| format!("<{path}>"))
    }

    /// Processor time of the thread so far, or what stands for it at `now`.
    fn cpu(&self, now: Instant) -> Duration {
        /// What `/proc` counts in, on every Linux.
        const TICKS_A_SECOND: u32 = 100;
        static BEGINNING: OnceLock<Instant> = OnceLock::new();
        let Some(place) = self.place.get() else {
            return Duration::ZERO;
        };
        let Some(folder) = &place.folder else {
            let elapsed = now.saturating_duration_since(*BEGINNING.get_or_init(|| now));
            return elapsed.mul_f64(SHARE_OF_TIME);
        };
        // a thread that ended has no such file
        let stat = std::fs::read_to_string(folder.join("stat")).unwrap_or_default();
        let behind_name = stat.rsplit(')').next().unwrap_or_default();
        let fields = behind_name.split_whitespace().skip(11).take(2);
        let ticks = fields.filter_map(|ticks| ticks.parse::<u32>().ok());
        Duration::from_secs(u64::from(ticks.sum::<u32>())) / TICKS_A_SECOND
    }

    /// Memory in use of the thread's stack, bytes, where the system tells.
    fn stack(&self) -> Option<u64> {
        let address = self.place.get()?.address;
        let maps = std::fs::read_to_string("/proc/self/smaps").ok()?;
        let mut is_stack = false;
        for line in maps.lines() {
            let range = line
                .split(' ')
                .next()
                .and_then(|range| range.split_once('-'));
            let hex = |text| usize::from_str_radix(text, 16).ok();
            if let Some((from, to)) = range.and_then(|(from, to)| Some((hex(from)?, hex(to)?))) {
                is_stack = (from..to).contains(&address);
            } else if let Some(size) = line.strip_prefix("Rss:").filter(|_| is_stack) {
                return kibibytes(size);
            }
        }
        None
    }
}

impl Watch<'_> {
    /// What tells that the thread will not come to an end, if anything does.
    pub(super) fn judge(&mut self) -> Option<String> {
        let step = self.pulse.steps.load(Ordering::Relaxed);
        if step != self.step {
            *self = self.pulse.watch();
            return None;
        }
        let took = self.pulse.cpu(Instant::now()).saturating_sub(self.cpu);
        if took < SHORT {
            return None;
        }
        let what = self.excess(took)?;
        // it may have gone on meanwhile
        (self.pulse.steps.load(Ordering::Relaxed) == step).then(|| {
            format!(
                "the native reader does not come to an end with {}: {what} without a further prim or layer; its arcs may lead in circles",
                self.pulse.subject()
            )
        })
    }

    fn excess(&mut self, took: Duration) -> Option<String> {
        let Limits { cpu, memory, stack } = self.pulse.limits;
        let (milliseconds, bytes) = &self.pulse.extra;
        let extra = Duration::from_millis(milliseconds.load(Ordering::Relaxed));
        if took > cpu.saturating_add(extra) {
            return Some(format!("{:.0} s of processor time", took.as_secs_f64()));
        }
        let grown = resident_memory().saturating_sub(self.memory);
        if grown > memory.saturating_add(bytes.load(Ordering::Relaxed)) {
            return Some(format!("{} MiB of memory", grown >> 20));
        }
        let in_use = self.pulse.stack()?;
        let before = *self.stack.get_or_insert(in_use);
        let overflows = in_use > stack && in_use > before;
        overflows.then(|| format!("{} MiB of stack", in_use >> 20))
    }
}

/// Memory that the process has in use, bytes; 0 where the system does not tell.
fn resident_memory() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    line.and_then(kibibytes).unwrap_or(0)
}

/// `12 kB` in bytes.
fn kibibytes(text: &str) -> Option<u64> {
    let number: u64 = text.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(number * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;
    use std::thread;

    /// Other tests need memory meanwhile.
    const SMALL: Limits = Limits {
        cpu: Duration::from_millis(700),
        memory: u64::MAX / 4,
        stack: 8 << 20,
    };

    /// What is said of a thread that does `work` until it is judged, or ends.
    fn judged(limits: Limits, work: impl FnOnce(&Pulse) + Send + 'static) -> Option<String> {
        let pulse = Arc::new(Pulse::new(limits));
        let of_thread = Arc::clone(&pulse);
        let worker = thread::Builder::new().stack_size(64 << 20);
        let worker = worker.spawn(move || {
            of_thread.is_of_this_thread();
            work(&of_thread);
        });
        let worker = worker.unwrap();
        let mut watch = pulse.watch();
        while !worker.is_finished() {
            thread::sleep(EVERY / 10);
            if let Some(what) = watch.judge() {
                pulse.give_up();
                worker.join().unwrap();
                return Some(what);
            }
        }
        None
    }

    #[test]
    fn work_without_a_step_is_judged_and_names_the_prim() {
        let what = judged(SMALL, |pulse| {
            pulse.prim(&sdf::Path::new("/a/b").unwrap());
            while !pulse.is_lost() {
                std::hint::spin_loop();
            }
        });
        let what = what.unwrap();
        assert!(what.contains("</a/b>: 1 s of processor time"), "{what}");
    }

    #[test]
    fn waiting_and_steps_are_no_reason() {
        let waited = judged(SMALL, |_| thread::sleep(Duration::from_secs(2)));
        assert_eq!(waited, None);
        let stepped = judged(SMALL, |pulse| {
            let start = Instant::now();
            while start.elapsed() < Duration::from_secs(2) {
                pulse.prims(1);
            }
        });
        assert_eq!(stepped, None);
    }

    #[test]
    fn a_large_layer_and_values_take_their_time() {
        let spun = |pulse: &Pulse| {
            let end = pulse.cpu(Instant::now()) + Duration::from_millis(1200);
            while pulse.cpu(Instant::now()) < end {}
        };
        let opened = judged(SMALL, move |pulse| {
            pulse.layer(5 << 20);
            spun(pulse);
        });
        assert_eq!(opened, None);
        let read = judged(SMALL, move |pulse| {
            pulse.values();
            spun(pulse);
        });
        assert_eq!(read, None);
    }

    #[test]
    fn memory_without_bound_is_judged() {
        let limits = Limits {
            cpu: Duration::from_secs(600),
            memory: 64 << 20,
            ..SMALL
        };
        let what = judged(limits, |pulse| {
            let mut all = Vec::new();
            while !pulse.is_lost() {
                if all.len() < 256 {
                    all.push(vec![1_u8; 1 << 20]);
                }
                std::hint::black_box(&all);
            }
        });
        assert!(what.unwrap().contains("MiB of memory"));
    }

    #[test]
    fn a_stack_without_bound_is_judged() {
        fn deeper(pulse: &Pulse, depth: u32) -> u64 {
            let here = std::hint::black_box([u64::from(depth); 1024]);
            let start = Instant::now();
            while start.elapsed() < Duration::from_millis(1) {
                std::hint::spin_loop();
            }
            match pulse.is_lost() || depth > 6000 {
                true => here[7],
                false => deeper(pulse, depth + 1) + here[9],
            }
        }
        let limits = Limits {
            cpu: Duration::from_secs(600),
            ..SMALL
        };
        let what = judged(limits, |pulse| {
            deeper(pulse, 0);
        });
        assert!(what.unwrap().contains("MiB of stack"));
    }
}
