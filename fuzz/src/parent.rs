//! The process that shares the time among targets, starts a child for each, and starts another when one aborts or hangs.

use crate::guard::Fault;
use crate::state::{self, Counts};
use crate::targets::{Error, Target};
use crate::{Arguments, WorkFolder, coverage, findings};
use std::process::{Child, Command, ExitStatus};
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// An input that runs so long hangs.
const HANG: Duration = Duration::from_secs(20);
/// Time between two looks at a child.
const LOOK: Duration = Duration::from_millis(50);
/// Children of one target; when so many have died, the target is given up.
const MAX_CHILDREN: u32 = 20;

/// What became of a target.
struct Row {
    name: &'static str,
    counts: Counts,
    /// Children that aborted or hung.
    deaths: u32,
    error: Option<String>,
}

/// Fuzzes the targets; whether none broke a rule.
///
/// # Errors
/// If a child cannot be started.
pub fn run(targets: &[Target], arguments: &Arguments) -> Result<bool, Error> {
    if !coverage::is_built_in() {
        println!("built without coverage counters, which fuzz/README.md tells how to add: mutates the seeds alone");
    }
    let shares: u32 = targets.iter().map(|t| t.share).sum();
    let seconds = arguments.seconds * arguments.jobs as f64 / f64::from(shares);
    let mut queue: Vec<&Target> = targets.iter().collect();
    // The longest first: the last ones then end together.
    queue.sort_by_key(|t| t.share);
    let (queue, rows) = (Mutex::new(queue), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        let worker = |_| scope.spawn(|| work(&queue, &rows, seconds, arguments));
        let workers: Vec<_> = (0..arguments.jobs).map(worker).collect();
        workers.into_iter().try_for_each(|w| w.join().unwrap_or_else(|_| Err("a watching thread failed".into())))
    })?;
    let mut rows = rows.into_inner().map_err(|e| e.to_string())?;
    rows.sort_by_key(|r: &Row| targets.iter().position(|t| t.name == r.name));
    print(&rows);
    Ok(rows.iter().all(|r| r.counts.faults == 0 && r.deaths == 0 && r.error.is_none()))
}

type Shared<T> = Mutex<Vec<T>>;

/// Takes one target after the other.
fn work(queue: &Shared<&Target>, rows: &Shared<Row>, seconds: f64, arguments: &Arguments) -> Result<(), Error> {
    loop {
        let next = queue.lock().map_err(|e| e.to_string())?.pop();
        let Some(target) = next else { return Ok(()) };
        let time = Duration::from_secs_f64(seconds * f64::from(target.share));
        let row = watch_target(target, time, arguments)?;
        rows.lock().map_err(|e| e.to_string())?.push(row);
    }
}

/// Runs children of a target until its time is over.
fn watch_target(target: &Target, time: Duration, arguments: &Arguments) -> std::io::Result<Row> {
    let work = WorkFolder::new()?;
    let mut row = Row { name: target.name, counts: Counts::default(), deaths: 0, error: None };
    let start = Instant::now();
    while row.deaths < MAX_CHILDREN && row.error.is_none() {
        let left = time.saturating_sub(start.elapsed());
        let mut child = Command::new(std::env::current_exe()?)
            .args(["--child", target.name, "--seconds", &left.as_secs_f64().to_string()])
            .args(["--seed", &arguments.seed.to_string(), "--inputs", &arguments.inputs.to_string()])
            .arg("--work")
            .arg(work.path())
            .spawn()?;
        let end = watch(&mut child, &work)?;
        let (counts, case) = state::read(&work.state());
        row.counts = counts;
        match end {
            Some(status) if status.success() => break,
            // An error that the child has printed.
            Some(status) if status.code().is_some() => row.error = Some("its child failed".into()),
            end => {
                row.deaths += 1;
                let (kind, why) = match end {
                    Some(status) => ("abort", format!("the process died: {status}")),
                    None => ("hang", format!("no end within {HANG:?}")),
                };
                findings::keep(target.name, &Fault { kind, why, place: None }, &case)?;
            }
        }
        if time <= start.elapsed() {
            break;
        }
    }
    Ok(row)
}

/// Waits for the end of a child; none if it had to be killed because an input did not end.
fn watch(child: &mut Child, work: &WorkFolder) -> std::io::Result<Option<ExitStatus>> {
    let mut last = (0, Instant::now());
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(Some(status));
        }
        let inputs = state::read(&work.state()).0.inputs;
        if inputs != last.0 || inputs == 0 {
            last = (inputs, Instant::now());
        }
        if last.1.elapsed() > HANG {
            child.kill()?;
            child.wait()?;
            return Ok(None);
        }
        std::thread::sleep(LOOK);
    }
}

fn print(rows: &[Row]) {
    println!("| target | inputs | accepted | edges | peak MiB | over bound | other faults | slowest s |");
    println!("|---|---|---|---|---|---|---|---|");
    for r in rows {
        let c = &r.counts;
        println!(
            "| {} | {} | {} | {} | {:.1} | {} | {} | {:.2} |",
            r.name,
            c.inputs,
            c.accepted,
            c.edges,
            c.peak as f64 / f64::from(1 << 20),
            c.over,
            c.faults - c.over + u64::from(r.deaths),
            c.slowest_us as f64 * 1e-6
        );
    }
    println!("| total | {} | | | | | | |", rows.iter().map(|r| r.counts.inputs).sum::<u64>());
    for r in rows {
        if let Some(error) = &r.error {
            println!("{}: {error}", r.name);
        }
        if r.counts.faults > 0 || r.deaths > 0 {
            for finding in findings::folders(&findings::folder().join(r.name)).unwrap_or_default() {
                println!("{}", finding.display());
            }
        }
    }
}
