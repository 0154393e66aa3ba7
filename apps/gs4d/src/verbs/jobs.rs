//! Trials of contests and sweeps: trained here, written as a list of jobs for any scheduler, or collected.

use crate::answer::Answer;
use crate::failure::{Class, Failure};
use crate::global::{Global, to_stderr};
use crate::interrupt;
use crate::output::{check_free, create_folder};
use crate::progress::Progress;
use gs_core::io::{folder_of, write_file};
use gs4d_lab::contest::{Contest, ContestError, Event, Job, Plan, Results, TrialError, run_all};
use gs4d_run::RunError;
use serde_json::{Value, json};
use std::fs;
use std::path::{Path, PathBuf};

/// What is done instead of training.
#[derive(clap::Args)]
pub struct Jobs {
    /// Train nothing: write a list of jobs, one gs4d train command line per trial, for any scheduler. The lines can run in any
    /// order and at once, and each can be repeated: it goes on with what it has saved, and does nothing when it is done.
    #[arg(long, value_name = "FILE", conflicts_with = "collect")]
    plan: Option<PathBuf>,
    /// Overwrite an older list of jobs, or files in the place of the results that gs4d did not write.
    #[arg(short, long)]
    force: bool,
    /// Paths in the list as typed, relative to this folder [default: absolute].
    #[arg(long, requires = "plan")]
    relative: bool,
    /// First words of every line, as the shell reads them, for example "nice -n 10 gs4d".
    #[arg(long, value_name = "CMD", default_value = "gs4d", requires = "plan")]
    program: String,
    /// Train nothing: make the results from the trials that stand. If some are missing, they are named, and the exit code
    /// is 7.
    #[arg(long)]
    collect: bool,
}

/// A file of results: its name, and words that it holds if gs4d wrote it.
pub type ResultFile = (&'static str, &'static str);

impl Jobs {
    /// Fails if a file that gs4d did not write is in the place of results, unless forced.
    pub fn check_results<N: AsRef<Path>>(&self, root: &Path, files: &[(N, &str)]) -> Result<(), Failure> {
        let foreign = files.iter().filter_map(|(name, words)| {
            let path = root.join(name);
            let holds_words = || fs::read(&path).is_ok_and(|text| String::from_utf8_lossy(&text).contains(words));
            (path.exists() && !holds_words()).then_some(path)
        });
        check_free(self.force, "file", "folder", foreign)
            .map_err(|f| f.why("gs4d did not write it, and nothing is overwritten unless asked"))
    }

    /// Writes the list of jobs of these contests, if it is asked for.
    pub fn plan(&self, contests: &[Contest], global: &Global) -> Result<Option<Answer>, Failure> {
        let Some(file) = &self.plan else { return Ok(None) };
        check_free(self.force, "list of jobs", "file", [file])
            .map_err(|f| f.remedy("choose another file, or pass -f"))?;
        create_folder(folder_of(file))?;
        let plan = self.planned(contests)?;
        let program = self.program.clone() + &flags(global);
        let lines: Vec<String> =
            plan.jobs.iter().map(|job| job.command(&program)).collect::<Result<_, _>>().map_err(failure)?;
        write_file(file, self.force, |out| lines.iter().try_for_each(|line| writeln!(out, "{line}")))?;
        if plan.pilots {
            global.say("these are the pilots of the time budget: run them, then plan again for the trials");
        }
        let job = |(job, line): (&Job, &String)| json!({"trial": job.trial, "run": job.run.display().to_string(), "command": line});
        let jobs: Vec<Value> = plan.jobs.iter().zip(&lines).map(job).collect();
        let what = if plan.pilots { "pilots" } else { "trials" };
        let text = format!("{} {what} -> {}\n", lines.len(), file.display());
        Ok(Some(Answer::new(text, json!({"pilots": plan.pilots, "jobs": jobs}))))
    }

    /// The jobs of all contests that come next: pilots first, where a time budget needs them.
    fn planned(&self, contests: &[Contest]) -> Result<Plan, Failure> {
        let mut plans = Vec::new();
        for contest in contests {
            let mut contest = contest.clone();
            if !self.relative {
                (contest.data, contest.root) = (absolute(&contest.data)?, absolute(&contest.root)?);
            }
            plans.push(contest.plan().map_err(failure)?);
        }
        let pilots = plans.iter().any(|p| p.pilots);
        let jobs = plans.into_iter().filter(|p| p.pilots == pilots).flat_map(|p| p.jobs).collect();
        Ok(Plan { pilots, jobs })
    }

    /// Trains the trials with a progress line for each, or collects them.
    pub fn results(&self, contest: &Contest, global: &Global) -> Result<Results, Failure> {
        let results = if self.collect { contest.collect() } else { follow(contest, global)? }.map_err(failure)?;
        if self.collect {
            results.missing.iter().for_each(|m| to_stderr(format_args!("missing: {m}")));
        }
        Ok(results)
    }

    /// The results of several contests with these names: trained with a line for each trial, one at a time on each thread, or collected.
    pub fn all_results(
        &self,
        contests: &[Contest],
        names: &[String],
        global: &Global,
    ) -> Result<Vec<Results>, Failure> {
        if self.collect {
            return contests.iter().map(|contest| self.results(contest, global)).collect();
        }
        let (stop, quiet) = (interrupt::flag()?, global.quiet);
        let on_event = |of: usize, event: Event| match event {
            Event::Trial(trial) if !quiet => to_stderr(format_args!("{} / {trial}", names[of])),
            Event::Failed(trial) => to_stderr(format_args!("failed: {} / {trial}", names[of])),
            Event::Trial(_) | Event::Step(_) => {}
        };
        run_all(contests, rayon::current_num_threads(), &stop, &on_event).map_err(failure)
    }

    /// The answer; if trials have no result, prints it and fails.
    pub fn judge(&self, answer: Answer, missing: Vec<TrialError>, global: &Global) -> Result<Answer, Failure> {
        let number = missing.len();
        let Some(first) = missing.into_iter().next() else { return Ok(answer) };
        answer.print(global.json)?;
        Err(match self.collect {
            true => Failure::new(Class::Verification, "missing", format!("trials without a result: {number}"))
                .why("the table is made from the others")
                .remedy("run the lines of --plan, then collect again"),
            false => failure(first.into()),
        })
    }
}

/// Trains the trials with a progress line for each, until done or interrupted.
fn follow(contest: &Contest, global: &Global) -> Result<Result<Results, ContestError>, Failure> {
    let stop = interrupt::flag()?;
    let mut progress: Option<Progress> = None;
    let finish = |progress: &mut Option<Progress>| progress.take().into_iter().for_each(Progress::finish);
    let results = contest.run(&stop, &mut |event| match event {
        Event::Trial(name) => {
            finish(&mut progress);
            global.say(name);
        }
        Event::Step(p) => Progress::step(&mut progress, p, global.quiet),
        Event::Failed(trial) => {
            finish(&mut progress);
            to_stderr(format_args!("failed: {trial}"));
        }
    });
    finish(&mut progress);
    Ok(results)
}

/// Fails if a seed is given twice.
pub fn check_seeds(seeds: &[u64]) -> Result<(), Failure> {
    match seeds.iter().enumerate().find(|(k, seed)| seeds[..*k].contains(seed)) {
        None => Ok(()),
        Some((_, seed)) => Err(Failure::usage(format!("the seed {seed} is given twice"))
            .why("the same training would count as two")
            .remedy("give distinct --seeds")),
    }
}

/// Adds the trials without a result to those of the others.
pub fn with_missing(mut json: Value, missing: &[TrialError]) -> Value {
    if !missing.is_empty() {
        json["missing"] = missing.iter().map(|m| json!({"trial": m.trial, "why": m.source.to_string()})).collect();
    }
    json
}

/// The failure of a contest or of a trial.
pub fn failure(e: ContestError) -> Failure {
    let text = e.to_string();
    match e {
        ContestError::Trial(TrialError { trial, source }) => {
            let other = matches!(*source, RunError::OtherSettings { .. });
            let failure = Failure::from(*source).why(format!("in the trial {trial}"));
            if other { failure.remedy("choose another folder with -o") } else { failure }
        }
        ContestError::Word { .. } => Failure::usage(text)
            .why("a list of jobs has one line per trial")
            .remedy("train without --plan, or choose other names"),
        ContestError::Interrupted(_) => {
            Failure::new(Class::Interrupted, "interrupted", text).remedy("the same command goes on where it stopped")
        }
    }
}

/// Flags of this call that every job gets too.
fn flags(global: &Global) -> String {
    let threads = global.threads.map_or(String::new(), |t| format!(" --threads {t}"));
    threads + &global.max_mem.map_or(String::new(), |m| format!(" --max-mem {m}"))
}

fn absolute(path: &Path) -> Result<PathBuf, Failure> {
    std::path::absolute(path).map_err(|e| Failure::io("find the absolute path", path, &e))
}
