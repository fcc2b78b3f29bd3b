//! A recipe → its tasks: one for each file and frame of a step, in an order in which all comes before what needs it.

use super::parse_bytes;
use super::recipe::{Each, Recipe, RecipeError, Step};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// One run of one command.
#[derive(Debug, Clone)]
pub struct Task {
    /// Name of its step.
    pub step: String,
    /// The file and the frame it is for, as people read it; empty if there is one only.
    pub label: String,
    /// The command and its arguments.
    pub command: Vec<String>,
    /// Files it reads, as far as the recipe tells.
    pub inputs: Vec<PathBuf>,
    /// Files it writes, as far as the recipe tells.
    pub outputs: Vec<PathBuf>,
    /// Earlier tasks that it waits for.
    pub needs: Vec<usize>,
    /// Bytes, if the recipe tells.
    pub memory: Option<u64>,
}

/// All tasks of a recipe.
#[derive(Debug, Clone)]
pub struct Plan {
    /// Each behind those it needs.
    pub tasks: Vec<Task>,
}

/// Frames as `--frames` has them.
pub type ParseFrames<'a> = &'a dyn Fn(&str) -> Result<Vec<f64>, String>;

/// Expand the `recipe` that was read from `path`. Patterns see the files that are there now.
///
/// # Errors
/// Patterns without files, unknown `{names}`, steps that wait for each other, two tasks that write one file.
pub fn plan(recipe: &Recipe, path: &Path, frames: ParseFrames<'_>) -> Result<Plan, RecipeError> {
    let folder = path
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    let expansion = Expansion {
        recipe,
        folder: folder.unwrap_or(Path::new(".")),
        frames,
    };
    expansion.plan().map_err(|message| RecipeError::Meaning {
        path: path.to_path_buf(),
        message,
    })
}

struct Expansion<'a> {
    recipe: &'a Recipe,
    /// Where the recipe lies.
    folder: &'a Path,
    frames: ParseFrames<'a>,
}

/// What a task of a step is for.
#[derive(Debug, Clone, Default)]
struct Item {
    file: Option<PathBuf>,
    frame: Option<f64>,
}

impl Expansion<'_> {
    fn plan(&self) -> Result<Plan, String> {
        let mut tasks: Vec<Task> = Vec::new();
        let mut of_step: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
        let order = self.step_order()?;
        for step in order {
            for item in self.items(step, &of_step, &tasks)? {
                let task = self.task(step, &item)?;
                of_step.entry(&step.name).or_default().push(tasks.len());
                tasks.push(task);
            }
        }
        self.link(&mut tasks, &of_step)?;
        sorted(tasks)
    }

    /// Steps behind those whose outputs they go on from.
    fn step_order(&self) -> Result<Vec<&Step>, String> {
        let mut order: Vec<&Step> = Vec::new();
        let mut left: Vec<&Step> = self.recipe.steps.iter().collect();
        while !left.is_empty() {
            let is_ready = |step: &Step| match &step.each {
                Some(Each::Step { step }) => order.iter().any(|done| done.name == *step),
                _ => true,
            };
            let ready: Vec<&Step> = left.iter().copied().filter(|step| is_ready(step)).collect();
            if ready.is_empty() {
                return Err(waiting(left.iter().map(|step| step.name.as_str())));
            }
            left.retain(|step| ready.iter().all(|one| one.name != step.name));
            order.extend(ready);
        }
        Ok(order)
    }

    fn items(
        &self,
        step: &Step,
        of_step: &BTreeMap<&str, Vec<usize>>,
        tasks: &[Task],
    ) -> Result<Vec<Item>, String> {
        let in_step = |message: String| format!("step `{}`: {message}", step.name);
        let files: Vec<Option<PathBuf>> = match &step.each {
            None => vec![None],
            Some(Each::Pattern(pattern)) => self.matches(&[pattern]).map_err(in_step)?,
            Some(Each::Patterns(patterns)) => {
                let patterns: Vec<&String> = patterns.iter().collect();
                self.matches(&patterns).map_err(in_step)?
            }
            Some(Each::Step { step: other }) => {
                let others = of_step.get(other.as_str()).into_iter().flatten();
                let outputs = others.flat_map(|&i| tasks[i].outputs.iter().cloned());
                let outputs: Vec<_> = outputs.map(Some).collect();
                if outputs.is_empty() {
                    let message = format!("step `{other}` names no outputs to go on from");
                    return Err(in_step(message));
                }
                outputs
            }
        };
        let frames: Vec<Option<f64>> = match &step.frames {
            None => vec![None],
            Some(text) => {
                let text = self.fill(text, &Item::default()).map_err(in_step)?;
                let frames = (self.frames)(&text).map_err(in_step)?;
                frames.into_iter().map(Some).collect()
            }
        };
        let at = |file: &Option<PathBuf>| {
            let file = file.clone();
            let item = move |&frame: &Option<f64>| Item {
                file: file.clone(),
                frame,
            };
            frames.iter().map(item).collect::<Vec<_>>()
        };
        Ok(files.iter().flat_map(at).collect())
    }

    /// Files that are there, each once, in the order of patterns and names.
    fn matches(&self, patterns: &[&String]) -> Result<Vec<Option<PathBuf>>, String> {
        let mut files = Vec::new();
        for pattern in patterns {
            let pattern = self.fill(pattern, &Item::default())?;
            let found = glob::glob(&pattern).map_err(|error| format!("`{pattern}`: {error}"))?;
            let before = files.len();
            for file in found {
                let file = file.map_err(|error| error.to_string())?;
                if !files.contains(&Some(file.clone())) {
                    files.push(Some(file));
                }
            }
            if files.len() == before {
                return Err(format!("no file matches `{pattern}`"));
            }
        }
        Ok(files)
    }

    fn task(&self, step: &Step, item: &Item) -> Result<Task, String> {
        let fill = |texts: &[String]| -> Result<Vec<String>, String> {
            let filled = texts.iter().map(|text| self.fill(text, item));
            filled
                .collect::<Result<_, _>>()
                .map_err(|message| format!("step `{}`: {message}", step.name))
        };
        let paths = |texts: &[String]| -> Result<Vec<PathBuf>, String> {
            Ok(fill(texts)?.into_iter().map(PathBuf::from).collect())
        };
        let mut inputs = paths(&step.inputs)?;
        inputs.extend(item.file.clone());
        let mut command = vec![step.command.clone()];
        command.extend(fill(&step.arguments)?);
        let memory = step.memory.as_deref().map(parse_bytes).transpose();
        let file = item.file.as_ref().map(|file| file.display().to_string());
        let frame = item.frame.map(|frame| format!("frame {frame}"));
        Ok(Task {
            step: step.name.clone(),
            label: file.into_iter().chain(frame).collect::<Vec<_>>().join(", "),
            command,
            inputs,
            outputs: paths(&step.outputs)?,
            needs: Vec::new(),
            memory: memory.map_err(|message| format!("step `{}`: {message}", step.name))?,
        })
    }

    /// Tell every task what it waits for.
    fn link(&self, tasks: &mut [Task], of_step: &BTreeMap<&str, Vec<usize>>) -> Result<(), String> {
        let mut writer: BTreeMap<PathBuf, usize> = BTreeMap::new();
        for (i, task) in tasks.iter().enumerate() {
            for output in &task.outputs {
                if let Some(other) = writer.insert(output.clone(), i) {
                    let (a, b) = (&tasks[other].step, &task.step);
                    let output = output.display();
                    return Err(format!(
                        "two tasks write {output} (steps `{a}` and `{b}`): name each file after {{each.stem}} or {{frame}}"
                    ));
                }
            }
        }
        let needs = |(i, task): (usize, &Task)| -> Vec<usize> {
            let step = self.recipe.steps.iter().find(|step| step.name == task.step);
            let after = step.iter().flat_map(|step| &step.after);
            let first = after.filter_map(|name| of_step.get(name.as_str()));
            let mut needs: BTreeSet<usize> = first.flatten().copied().collect();
            let arguments = task.command.iter().map(PathBuf::from);
            let read = task.inputs.iter().cloned().chain(arguments);
            needs.extend(read.filter_map(|path| writer.get(&path)));
            needs.remove(&i);
            needs.into_iter().collect()
        };
        let needs: Vec<Vec<usize>> = tasks.iter().enumerate().map(needs).collect();
        for (task, needs) in tasks.iter_mut().zip(needs) {
            task.needs = needs;
        }
        Ok(())
    }

    /// `text` with what its `{names}` stand for.
    fn fill(&self, text: &str, item: &Item) -> Result<String, String> {
        let mut filled = String::new();
        let mut rest = text;
        while let Some(at) = rest.find(['{', '}']) {
            filled.push_str(&rest[..at]);
            let brace = &rest[at..=at];
            rest = &rest[at + 1..];
            if let Some(after) = rest.strip_prefix(brace) {
                filled.push_str(brace);
                rest = after;
                continue;
            }
            let end = rest.find('}').filter(|_| brace == "{");
            let Some(end) = end else {
                return Err(format!(
                    "`{text}`: a lone `{brace}`; write `{brace}{brace}` for a brace"
                ));
            };
            filled.push_str(&self.value(&rest[..end], item)?);
            rest = &rest[end + 1..];
        }
        filled.push_str(rest);
        Ok(filled)
    }

    fn value(&self, name: &str, item: &Item) -> Result<String, String> {
        let of_file = |part: fn(&Path) -> Option<&std::ffi::OsStr>| {
            let file = item.file.as_deref();
            file.and_then(|file| Some(part(file)?.to_string_lossy().into_owned()))
        };
        let (plain, width) = name
            .split_once(':')
            .map_or((name, None), |(a, b)| (a, Some(b)));
        let found = match plain {
            "each" => of_file(|file| Some(file.as_os_str())),
            "each.stem" => of_file(Path::file_stem),
            "each.name" => of_file(Path::file_name),
            "each.folder" => of_file(|file| {
                let folder = file.parent().map(Path::as_os_str);
                folder.map(|folder| {
                    if folder.is_empty() {
                        ".".as_ref()
                    } else {
                        folder
                    }
                })
            }),
            "frame" => item.frame.map(|frame| padded(frame, width)).transpose()?,
            "recipe" => Some(self.folder.display().to_string()),
            setting => {
                let value = self.recipe.settings.get(setting);
                value
                    .and_then(|value| value.as_ref())
                    .map(super::recipe::Value::text)
            }
        };
        found.ok_or_else(|| match plain {
            "each" | "each.stem" | "each.name" | "each.folder" => {
                format!("`{{{name}}}` needs `each` in the step")
            }
            "frame" => "`{frame}` needs `frames` in the step".to_owned(),
            _ => {
                let known: Vec<&str> = self.recipe.settings.keys().map(String::as_str).collect();
                format!(
                    "nothing is called `{{{name}}}`; there are the settings {}",
                    known.join(", ")
                )
            }
        })
    }
}

/// `frame` with at least `width` digits before the point: `04`.
fn padded(frame: f64, width: Option<&str>) -> Result<String, String> {
    let width = width.map_or(Ok(0), |text| {
        text.parse::<usize>().map_err(|_| {
            format!("`{{frame:{text}}}`: a number of digits is needed, as in {{frame:04}}")
        })
    })?;
    let text = frame.abs().to_string();
    let (whole, part) = text.split_at(text.find('.').unwrap_or(text.len()));
    let sign = if frame < 0.0 { "-" } else { "" };
    Ok(format!("{sign}{whole:0>width$}{part}"))
}

/// Tasks behind those they need, otherwise as they were.
fn sorted(tasks: Vec<Task>) -> Result<Plan, String> {
    let mut place = vec![usize::MAX; tasks.len()];
    let mut order = Vec::with_capacity(tasks.len());
    while order.len() < tasks.len() {
        let before = order.len();
        for (i, task) in tasks.iter().enumerate() {
            let is_placed = |&j: &usize| place[j] != usize::MAX;
            if place[i] == usize::MAX && task.needs.iter().all(is_placed) {
                place[i] = order.len();
                order.push(i);
            }
        }
        if order.len() == before {
            let left = tasks
                .iter()
                .zip(&place)
                .filter(|(_, place)| **place == usize::MAX);
            let names: BTreeSet<&str> = left.map(|(task, _)| task.step.as_str()).collect();
            return Err(waiting(names.into_iter()));
        }
    }
    let mut moved: Vec<Option<Task>> = tasks.into_iter().map(Some).collect();
    let task = |i: &usize| {
        let mut task = moved[*i].take()?;
        task.needs.iter_mut().for_each(|j| *j = place[*j]);
        Some(task)
    };
    Ok(Plan {
        tasks: order.iter().filter_map(task).collect(),
    })
}

fn waiting<'s>(names: impl Iterator<Item = &'s str>) -> String {
    let names: Vec<String> = names.map(|name| format!("`{name}`")).collect();
    format!("steps wait for each other: {}", names.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recipe(text: &str) -> Recipe {
        serde_json::from_str(text).unwrap()
    }

    fn planned(text: &str) -> Result<Plan, String> {
        let frames = |text: &str| {
            text.split(',')
                .map(|f| f.parse().map_err(|_| "no".to_owned()))
                .collect()
        };
        let found = plan(&recipe(text), Path::new("kitchen/r.json"), &frames);
        found.map_err(|error| error.to_string())
    }

    #[test]
    fn tasks_follow_what_they_read_whatever_the_order_of_steps() {
        let plan = planned(
            r#"{"settings": {"t": 0.02}, "steps": [
                {"name": "show", "command": "view", "each": {"step": "bake"}, "arguments": ["{each}", "-o", "{each.stem}.png"]},
                {"name": "bake", "command": "bake", "frames": "7,-8.5", "arguments": ["{recipe}/a.usd", "--tolerance", "{t}"],
                 "outputs": ["b.{frame:04}.usdc"], "memory": "2GiB"},
                {"name": "last", "command": "info", "arguments": ["x{{y=z}}"], "after": ["show"]}]}"#,
        )
        .unwrap();
        let lines: Vec<String> = plan
            .tasks
            .iter()
            .map(|task| task.command.join(" "))
            .collect();
        assert_eq!(
            lines,
            [
                "bake kitchen/a.usd --tolerance 0.02",
                "bake kitchen/a.usd --tolerance 0.02",
                "view b.0007.usdc -o b.0007.png",
                "view b.-0008.5.usdc -o b.-0008.5.png",
                "info x{y=z}",
            ]
        );
        assert_eq!(plan.tasks[2].needs, [0]);
        assert_eq!(plan.tasks[3].needs, [1]);
        assert_eq!(plan.tasks[4].needs, [2, 3]);
        assert_eq!(plan.tasks[0].memory, Some(2 << 30));
        assert_eq!(plan.tasks[0].label, "frame 7");
    }

    #[test]
    fn mistakes_are_named() {
        let step =
            |rest: &str| format!(r#"{{"steps": [{{"name": "a", "command": "info", {rest}}}]}}"#);
        let says = |text: &str, what: &str| {
            let error = planned(text).unwrap_err();
            assert!(error.contains(what), "{error}");
        };
        says(&step(r#""arguments": ["{x}"]"#), "nothing is called `{x}`");
        says(&step(r#""arguments": ["{each}"]"#), "needs `each`");
        says(&step(r#""arguments": ["{frame}"]"#), "needs `frames`");
        says(&step(r#""arguments": ["a}b"]"#), "a lone `}`");
        says(
            &step(r#""arguments": [], "each": "no/such/*.usd""#),
            "no file matches",
        );
        says(&step(r#""arguments": [], "memory": "much""#), "`much`");
        says(
            &step(r#""arguments": [], "frames": "1,2", "outputs": ["x"]"#),
            "two tasks write x",
        );
        says(
            r#"{"steps": [
                {"name": "a", "command": "info", "arguments": ["y"], "outputs": ["x"]},
                {"name": "b", "command": "info", "arguments": ["x"], "outputs": ["y"]}]}"#,
            "wait for each other: `a`, `b`",
        );
    }
}
