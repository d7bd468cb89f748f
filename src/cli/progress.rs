//! Progress on standard error: a bar with the time left on a terminal, a quiet line now and then
//! elsewhere.

use indicatif::{HumanDuration, ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::{IsTerminal, Write};
use std::sync::{Mutex, OnceLock};
use std::time::{Duration, Instant};
use vlf::bake::Progress;
use vlf::format::manifest::Phase;

/// Seconds between lines where there is no terminal.
const QUIET: Duration = Duration::from_secs(10);

/// Seconds after which a run's speed says something.
const SURE: f64 = 2.0;

/// What shows how far something has come.
pub struct Bar {
    bar: ProgressBar,
    terminal: bool,
    started: Instant,
    /// When the last quiet line was written.
    line: Mutex<Instant>,
    /// Seconds and work of a bake when it first told of any: what it took until then says nothing of its speed.
    first: OnceLock<(f64, f64)>,
}

impl Bar {
    /// Begins with a name for what is being done.
    pub fn new(name: &'static str) -> Bar {
        let terminal = std::io::stderr().is_terminal();
        let bar = ProgressBar::with_draw_target(Some(1000), ProgressDrawTarget::stderr());
        if let Ok(style) = ProgressStyle::with_template("{prefix:>10} [{bar:32}] {msg}") {
            bar.set_style(style.progress_chars("=> "));
        }
        bar.set_prefix(name);
        let line = Mutex::new(Instant::now());
        Bar { bar, terminal, started: Instant::now(), line, first: OnceLock::new() }
    }

    /// Shows a finished part in [0, 1].
    pub fn part(&self, part: f32) {
        self.show(part.into(), String::new());
    }

    /// Shows how far a bake has come, and how long the rest will take at the speed of this run.
    pub fn bake(&self, p: &Progress) {
        let what = match p.phase {
            _ if p.preparing => {
                format!("looking where light can come: {} of {} directions", p.done, p.directions)
            }
            Phase::Propagating => format!(
                "cycle {}: {} of {} directions, {:.2} % of the light unshot",
                p.cycle + 1,
                p.done,
                p.directions,
                100.0 * p.unshot
            ),
            _ => format!("total maps: {} of {} directions", p.done, p.directions),
        };
        let seconds = self.started.elapsed().as_secs_f64();
        let first = self.first.get_or_init(|| (seconds, p.work));
        let (seconds, work) = (seconds - first.0, p.work - first.1);
        let left = if work > 0.0 && seconds > SURE {
            let left = Duration::from_secs_f64(seconds / work * p.work_left);
            format!(", about {} left", HumanDuration(left))
        } else {
            String::new()
        };
        self.show(p.work / (p.work + p.work_left), format!("{what}{left}"));
    }

    fn show(&self, part: f64, message: String) {
        self.bar.set_position((1000.0 * part) as u64);
        if !self.terminal && !message.is_empty() {
            let Ok(mut line) = self.line.lock() else { return };
            if line.elapsed() >= QUIET || part >= 1.0 {
                *line = Instant::now();
                let _ = writeln!(std::io::stderr(), "{}", message);
            }
        }
        self.bar.set_message(message);
    }

    /// Takes the bar away; returns how long it stood.
    pub fn end(&self) -> Duration {
        self.bar.finish_and_clear();
        self.started.elapsed()
    }
}

/// A line on standard error.
pub fn tell(line: &str) {
    let _ = writeln!(std::io::stderr(), "{line}");
}
