//! Runs the tasks of a plan: each in a process of its own, as many at a time as there is memory for.

use super::manifest::{Finished, Manifest, Print};
use super::plan::{ParseFrames, Plan, Task, plan};
use super::recipe::{PYTHON, Recipe, RecipeError};
use crate::diagnostics::Diagnostics;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::mpsc;
use std::time::{Duration, Instant};

/// What to run, and how.
#[derive(Debug, Clone)]
pub struct RunRecipeJob {
    /// The command line, told with what was done.
    pub command: Vec<String>,
    /// The recipe.
    pub recipe: PathBuf,
    /// Values that replace its settings.
    pub sets: Vec<(String, String)>,
    /// What earlier runs did.
    pub manifest: PathBuf,
    /// Trust the manifest: what was finished and is there is not looked at again.
    pub resume: bool,
    /// Run what is up to date too.
    pub force: bool,
    /// Tell what would be run, and run nothing.
    pub dry_run: bool,
    /// Tasks at a time, at most.
    pub jobs: usize,
    /// Bytes for all tasks at a time.
    pub memory: Option<u64>,
    /// Threads of all tasks at a time.
    pub threads: usize,
    /// The program that steps run, and the interpreter of scripts.
    pub program: PathBuf,
    /// See `program`.
    pub python: PathBuf,
}

/// How a task came out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// It would be run (`--dry-run`).
    Due,
    /// Its files are as they were.
    UpToDate,
    /// It was run.
    Done,
    /// It ended with an error.
    Failed,
    /// One that it needs failed.
    LeftOut,
}

/// One task of a [`RunReport`].
#[derive(Debug, Clone, Serialize)]
pub struct TaskReport {
    /// Name of its step.
    pub step: String,
    /// What it is for.
    pub label: String,
    /// The command and its arguments.
    pub command: Vec<String>,
    /// How it came out.
    pub state: State,
    /// Wall clock.
    pub seconds: f64,
    /// Files it wrote.
    pub outputs: Vec<PathBuf>,
    /// Messages of its warnings.
    pub warnings: Vec<String>,
    /// What it said when it failed.
    pub error: Option<String>,
}

/// What a recipe did.
#[derive(Debug, Clone, Serialize)]
pub struct RunReport {
    /// Version.
    pub surflux: &'static str,
    /// The command line.
    pub command: Vec<String>,
    /// The recipe.
    pub recipe: PathBuf,
    /// In order.
    pub tasks: Vec<TaskReport>,
    /// Wall clock.
    pub seconds: f64,
}

impl RunReport {
    /// Tasks that came out so.
    pub fn count(&self, state: State) -> usize {
        self.tasks.iter().filter(|task| task.state == state).count()
    }
}

/// Run the recipe of `job`. What fails takes only those with it that need it. `tell` hears of every task that is over.
///
/// # Errors
/// Recipes that make no sense, and cancelling. Failed tasks are in the report.
pub fn run(
    job: &RunRecipeJob,
    frames: ParseFrames<'_>,
    tell: &mut dyn FnMut(&TaskReport),
    diagnostics: &Diagnostics,
) -> Result<RunReport, RecipeError> {
    let start = Instant::now();
    let recipe = Recipe::read(&job.recipe, &job.sets)?;
    let plan = plan(&recipe, &job.recipe, frames)?;
    let kitchen = Kitchen {
        job,
        manifest: Manifest::read(&job.manifest),
        states: vec![None; plan.tasks.len()],
        reports: vec![None; plan.tasks.len()],
        plan: &plan,
    };
    let tasks = kitchen.run(tell, diagnostics)?;
    Ok(RunReport {
        surflux: env!("CARGO_PKG_VERSION"),
        command: job.command.clone(),
        recipe: job.recipe.clone(),
        tasks,
        seconds: start.elapsed().as_secs_f64(),
    })
}

/// What is known of a task.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Course {
    Running { memory: u64 },
    Over(State),
}

/// Tasks at work.
struct Kitchen<'a> {
    job: &'a RunRecipeJob,
    plan: &'a Plan,
    manifest: Manifest,
    states: Vec<Option<Course>>,
    reports: Vec<Option<TaskReport>>,
}

/// A process that ended, after so many seconds.
type Ended = (usize, std::io::Result<Output>, f64);

/// Pause between two looks at whether the run was cancelled.
const BREATH: Duration = Duration::from_millis(100);

impl Kitchen<'_> {
    fn run(
        mut self,
        tell: &mut dyn FnMut(&TaskReport),
        diagnostics: &Diagnostics,
    ) -> Result<Vec<TaskReport>, RecipeError> {
        let (send, receive) = mpsc::channel::<Ended>();
        let mut children: BTreeMap<usize, u32> = BTreeMap::new();
        loop {
            while let Some(i) = self.next() {
                let task = &self.plan.tasks[i];
                if let Some(state) = self.settled(task) {
                    self.over(i, bare(task, state), tell);
                    continue;
                }
                match self.start(task) {
                    Ok(child) => {
                        children.insert(i, child.id());
                        let memory = self.memory(task);
                        self.states[i] = Some(Course::Running { memory });
                        wait_for(i, child, send.clone());
                    }
                    Err(error) => {
                        let program = self.program(task).display().to_string();
                        let report = TaskReport {
                            error: Some(format!("{program}: cannot be started: {error}")),
                            ..bare(task, State::Failed)
                        };
                        self.over(i, report, tell);
                    }
                }
            }
            if children.is_empty() {
                break;
            }
            if let Ok((i, output, seconds)) = receive.recv_timeout(BREATH) {
                children.remove(&i);
                let report = self.ended(i, output, seconds)?;
                self.over(i, report, tell);
            }
            if diagnostics.check().is_err() {
                children.values().for_each(|&id| end(id));
                // They tidy up, and end by themselves.
                while let Some((&i, _)) = children.iter().next() {
                    match receive.recv() {
                        Ok((ended, ..)) => children.remove(&ended),
                        Err(_) => children.remove(&i),
                    };
                }
                return Err(RecipeError::Cancelled);
            }
        }
        Ok(self.reports.into_iter().flatten().collect())
    }

    /// A task that can be started now, if there is one.
    fn next(&self) -> Option<usize> {
        let running = self
            .states
            .iter()
            .flatten()
            .filter_map(|course| match course {
                Course::Running { memory } => Some(*memory),
                Course::Over(_) => None,
            });
        let (count, taken) = running.fold((0, 0_u64), |(count, sum), memory| {
            (count + 1, sum.saturating_add(memory))
        });
        if count >= self.job.jobs.max(1) {
            return None;
        }
        let tasks = self.plan.tasks.iter().enumerate();
        let waits = |task: &Task| {
            task.needs
                .iter()
                .any(|&j| !matches!(self.states[j], Some(Course::Over(_))))
        };
        let fits = |task: &Task| {
            let all = self.job.memory.unwrap_or(u64::MAX);
            count == 0 || taken.saturating_add(self.memory(task)) <= all
        };
        let mut ready = tasks.filter(|(i, task)| self.states[*i].is_none() && !waits(task));
        ready.find(|(_, task)| fits(task)).map(|(i, _)| i)
    }

    /// Bytes that a task is counted with.
    fn memory(&self, task: &Task) -> u64 {
        let Some(all) = self.job.memory else {
            return 0;
        };
        let last = self.manifest.finished(&task.command);
        let last = last.and_then(|finished| finished.peak_memory);
        task.memory.or(last).unwrap_or(all)
    }

    /// How a task comes out that is not run.
    fn settled(&self, task: &Task) -> Option<State> {
        let state_of = |&j: &usize| match self.states[j] {
            Some(Course::Over(state)) => Some(state),
            _ => None,
        };
        let needs: Vec<State> = task.needs.iter().filter_map(state_of).collect();
        if needs
            .iter()
            .any(|state| matches!(state, State::Failed | State::LeftOut))
        {
            return Some(State::LeftOut);
        }
        // What is made anew may come out the same; whether it did shows when it is there.
        let is_fed_anew = self.job.dry_run && needs.contains(&State::Due);
        let finished = self.manifest.finished(&task.command);
        let is_done = finished.is_some_and(|finished| {
            if self.job.resume {
                finished.is_there()
            } else {
                finished.is_up_to_date()
            }
        });
        if is_done && !self.job.force && !is_fed_anew {
            return Some(State::UpToDate);
        }
        self.job.dry_run.then_some(State::Due)
    }

    fn program(&self, task: &Task) -> &Path {
        if task.command[0] == PYTHON {
            &self.job.python
        } else {
            &self.job.program
        }
    }

    fn start(&self, task: &Task) -> std::io::Result<Child> {
        for folder in task.outputs.iter().filter_map(|output| output.parent()) {
            std::fs::create_dir_all(folder)?;
        }
        let mut command = Command::new(self.program(task));
        if task.command[0] == PYTHON {
            command.args(&task.command[1..]);
        } else {
            command.args(&task.command);
            command.args(["--json", "--progress", "none"]);
            let jobs = self.job.jobs.max(1);
            if jobs > 1 && !task.command.iter().any(|argument| argument == "--threads") {
                let threads = (self.job.threads / jobs).max(1).to_string();
                command.args(["--threads", &threads]);
            }
        }
        let command = command.stdin(Stdio::null());
        command
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
    }

    fn ended(
        &mut self,
        i: usize,
        output: std::io::Result<Output>,
        seconds: f64,
    ) -> Result<TaskReport, RecipeError> {
        let task = &self.plan.tasks[i];
        let failed = |error: String| TaskReport {
            seconds,
            error: Some(error),
            ..bare(task, State::Failed)
        };
        let output = match output {
            Ok(output) => output,
            Err(error) => return Ok(failed(error.to_string())),
        };
        if !output.status.success() {
            let said = String::from_utf8_lossy(&output.stderr);
            let said = said.trim_end();
            let status = output.status;
            return Ok(failed(if said.is_empty() {
                status.to_string()
            } else {
                said.to_owned()
            }));
        }
        let told = Told::of(&output.stdout);
        let outputs: Vec<PathBuf> = (task.outputs.iter().cloned())
            .chain(told.outputs.iter().cloned())
            .collect();
        let finished = match finished(task, &told, &outputs) {
            Ok(finished) => finished,
            Err(error) => return Ok(failed(error)),
        };
        self.manifest.add(&task.command, finished);
        let path = &self.job.manifest;
        self.manifest
            .write(path)
            .map_err(|source| RecipeError::Manifest {
                path: path.clone(),
                source,
            })?;
        Ok(TaskReport {
            seconds,
            outputs,
            warnings: told.warnings,
            ..bare(task, State::Done)
        })
    }

    fn over(&mut self, i: usize, report: TaskReport, tell: &mut dyn FnMut(&TaskReport)) {
        tell(&report);
        self.states[i] = Some(Course::Over(report.state));
        self.reports[i] = Some(report);
    }
}

/// A report without results.
fn bare(task: &Task, state: State) -> TaskReport {
    TaskReport {
        step: task.step.clone(),
        label: task.label.clone(),
        command: task.command.clone(),
        state,
        seconds: 0.0,
        outputs: task.outputs.clone(),
        warnings: Vec::new(),
        error: None,
    }
}

/// Send the end of `child` to whoever waits.
fn wait_for(i: usize, child: Child, send: mpsc::Sender<Ended>) {
    let start = Instant::now();
    std::thread::spawn(move || {
        let output = child.wait_with_output();
        // Nobody waits any more only where the run was given up.
        let _ = send.send((i, output, start.elapsed().as_secs_f64()));
    });
}

/// Ask a process to end.
#[cfg(unix)]
fn end(id: u32) {
    use rustix::process::{Pid, Signal, kill_process};
    let pid = i32::try_from(id).ok().and_then(Pid::from_raw);
    if let Some(pid) = pid {
        // It may have ended by itself meanwhile.
        let _ = kill_process(pid, Signal::TERM);
    }
}

/// Processes of a console get its signals themselves.
#[cfg(not(unix))]
fn end(_: u32) {}

/// What a run of surflux tells of itself.
#[derive(Debug, Default)]
struct Told {
    outputs: Vec<PathBuf>,
    files: Vec<PathBuf>,
    warnings: Vec<String>,
    peak_memory: Option<u64>,
}

impl Told {
    /// Nothing where `stdout` is no report.
    fn of(stdout: &[u8]) -> Self {
        let report: serde_json::Value = serde_json::from_slice(stdout).unwrap_or_default();
        let texts = |list: &serde_json::Value| -> Vec<String> {
            let list = list.as_array().into_iter().flatten();
            list.filter_map(|text| Some(text.as_str()?.to_owned()))
                .collect()
        };
        let paths = |list| texts(list).into_iter().map(PathBuf::from).collect();
        let warnings = report["warnings"].as_array().into_iter().flatten();
        let warning = |warning: &serde_json::Value| {
            let text = |key: &str| warning[key].as_str().unwrap_or_default().to_owned();
            format!("{}: {}", text("prim"), text("message"))
        };
        Self {
            outputs: paths(&report["outputs"]),
            files: paths(&report["read"]["files"]),
            warnings: warnings.map(warning).collect(),
            peak_memory: report["peak_memory_bytes"].as_u64(),
        }
    }
}

fn finished(task: &Task, told: &Told, outputs: &[PathBuf]) -> Result<Finished, String> {
    let print = |path: &PathBuf| Some((path.clone(), Print::of(path).ok()?));
    let missing = outputs.iter().find(|path| !path.is_file());
    if let Some(missing) = missing {
        return Err(format!("it did not write {}", missing.display()));
    }
    let arguments = task.command[1..].iter().map(PathBuf::from);
    let named: Vec<PathBuf> = arguments.filter(|path| path.is_file()).collect();
    let inputs = task.inputs.iter().chain(&told.files).chain(&named);
    let inputs = inputs.filter(|path| !outputs.contains(path));
    Ok(Finished {
        inputs: inputs.filter_map(print).collect(),
        outputs: outputs.iter().filter_map(print).collect(),
        peak_memory: told.peak_memory,
    })
}

/// Units of memory.
const UNITS: [(&str, f64); 9] = [
    ("GiB", 1_073_741_824.0),
    ("MiB", 1_048_576.0),
    ("KiB", 1024.0),
    ("GB", 1e9),
    ("MB", 1e6),
    ("KB", 1e3),
    ("G", 1_073_741_824.0),
    ("M", 1_048_576.0),
    ("B", 1.0),
];

/// Bytes of `2GiB`, `500MiB`, `1.5GB`.
///
/// # Errors
/// What is no number with a unit of memory.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "checked to be a number above 0"
)]
pub fn parse_bytes(text: &str) -> Result<u64, String> {
    let unit = UNITS
        .iter()
        .find_map(|(unit, size)| Some((text.strip_suffix(unit)?, size)));
    let (number, size) = unit.unwrap_or((text, &1.0));
    match number.trim().parse::<f64>() {
        Ok(number) if number > 0.0 && number.is_finite() => Ok((number * size) as u64),
        _ => Err(format!("`{text}` is no memory: right are 4GiB, 500MiB")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_has_units() {
        assert_eq!(parse_bytes("4GiB"), Ok(4 << 30));
        assert_eq!(parse_bytes("1.5 GB"), Ok(1_500_000_000));
        assert_eq!(parse_bytes("100"), Ok(100));
        assert!(parse_bytes("-1GiB").is_err() && parse_bytes("GiB").is_err());
    }

    #[test]
    fn reports_are_read_and_other_text_is_none() {
        let told = Told::of(
            br#"{"outputs": ["a"], "read": {"files": ["b"]}, "peak_memory_bytes": 3,
            "warnings": [{"kind": "k", "prim": "/p", "message": "m"}]}"#,
        );
        assert_eq!(told.outputs, [PathBuf::from("a")]);
        assert_eq!(told.files, [PathBuf::from("b")]);
        assert_eq!(told.warnings, ["/p: m"]);
        assert_eq!(told.peak_memory, Some(3));
        assert!(Told::of(b"hello").outputs.is_empty());
    }
}
