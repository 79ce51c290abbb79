//! How often processes of a run died and were started again, from its log: a run that ends well says so, too.

use crate::output::format::counted;
use crate::output::log_line::LogLine;
use crate::supervisor::messages::restart_in;
use proto::run_folder::RunFolder;
use std::collections::BTreeMap;
use std::io::BufRead;

const LOG_BYTES_MOST: u64 = 1 << 30;

/// A sentence of actors and one of learners, if any died; nothing of a log that cannot be read.
pub fn restarts(folder: &RunFolder) -> Vec<String> {
    let log = folder.reader(&folder.log("orchestrator"), LOG_BYTES_MOST);
    let mut found: BTreeMap<String, (u64, String)> = BTreeMap::new();
    for line in log.into_iter().flat_map(|log| log.lines().map_while(Result::ok)) {
        if let Some((who, why)) = restart_in(LogLine::parse(&line).text) {
            let (count, last) = found.entry(who.split('-').next().unwrap_or(who).to_owned()).or_default();
            *count += 1;
            *last = format!("{who}, {why}");
        }
    }
    let sentence = |(kind, (count, last))| format!("{kind}s restarted {}; the last: {last}", counted(count, "time"));
    found.into_iter().map(sentence).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::supervisor::event::Exit;
    use crate::supervisor::messages::{actor_died, rewinds};

    #[test]
    fn deaths_are_counted_with_the_last() {
        let temporary = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(temporary.path());
        assert_eq!(restarts(&folder), [""; 0]);
        std::fs::create_dir(folder.logs()).unwrap();
        let words = ["2026-11-21T02:04:23.1Z ERROR actor 0: environment 1, episode 11, step 6: step() raised KeyError"];
        let died = |number| actor_died("actor-00", &Exit::Code(1), &words.map(str::to_owned), number);
        let learner = format!("learner-0 died: exit status 1; start number 2 follows; {}", rewinds(1, false));
        let texts = [died(2), "actor-00: ready".to_owned(), learner, died(3)];
        let lines = texts.map(|text| format!("2026-11-21T02:04:23.1Z  WARN orchestrator::supervisor::shell: {text}\n"));
        std::fs::write(folder.log("orchestrator"), lines.concat()).unwrap();
        let last = "actor-00, exit status 1, environment 1, episode 11, step 6: step() raised KeyError";
        let expected = [
            format!("actors restarted 2 times; the last: {last}"),
            "learners restarted 1 time; the last: learner-0, exit status 1".to_owned(),
        ];
        assert_eq!(restarts(&folder), expected);
    }
}
