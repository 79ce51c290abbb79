//! Blocks of code in a page.

/// Why a block is not run by a test: the words behind `norun=`.
pub const REASONS: [(&str, &str); 9] = [
    ("browser", "it opens a page or goes on until it is interrupted"),
    ("build", "it compiles or installs: other tests and CI do that"),
    ("cluster", "it needs several machines, Slurm or Kubernetes"),
    ("container", "it needs docker or podman"),
    ("gpu", "it needs a GPU"),
    ("long", "it takes minutes or hours"),
    ("program", "it needs a program that is none of ours"),
    ("root", "it changes the machine"),
    ("terminal", "it draws on a terminal"),
];

/// What becomes of a block of commands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum How {
    /// A test runs it as it stands.
    Run,
    /// A test runs it, and `stillroom up` gets a tiny network and few frames.
    RunSmall,
    NotRun,
    /// It says nothing, or something that means nothing.
    Unsaid,
}

/// A block of code between fences.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Block {
    /// The line of its fence in the page, from 1.
    pub line: usize,
    /// What stands behind the fence: a language, then attributes with commas between them.
    pub info: String,
    /// What stands between the fences.
    pub text: String,
}

impl Block {
    /// The blocks of a text; none at the end if a fence is never closed.
    pub(crate) fn of(text: &str) -> Vec<Self> {
        let mut found = vec![];
        let mut open: Option<Self> = None;
        for (number, line) in text.lines().enumerate() {
            let fence = line.trim_start().strip_prefix("```");
            match (fence, open.take()) {
                (Some(info), None) => {
                    open = Some(Self { line: number + 1, info: info.trim().to_owned(), text: String::new() });
                }
                (Some(_), Some(block)) => found.push(block),
                (None, Some(mut block)) => {
                    block.text.push_str(line);
                    block.text.push('\n');
                    open = Some(block);
                }
                (None, None) => {}
            }
        }
        found
    }

    /// The language; empty where there is none.
    pub fn language(&self) -> &str {
        self.info.split(',').next().unwrap_or_default()
    }

    /// What it is a copy of: path from the root, and the name of an anchor in that file behind a colon.
    pub fn from(&self) -> Option<&str> {
        self.info.split(',').find_map(|attribute| attribute.strip_prefix("from="))
    }

    /// What becomes of it, if it holds commands.
    pub fn how(&self) -> How {
        let mut attributes = self.info.split(',').skip(1).filter(|attribute| !attribute.starts_with("from="));
        match (attributes.next(), attributes.next()) {
            (Some("run"), None) => How::Run,
            (Some("run=small"), None) => How::RunSmall,
            (Some(other), None) => match other.strip_prefix("norun=") {
                Some(reason) if REASONS.iter().any(|(known, _)| *known == reason) => How::NotRun,
                _ => How::Unsaid,
            },
            _ => How::Unsaid,
        }
    }

    /// The calls of our programs in it, as words without comments; lines that end in a backslash are joined, and a call
    /// ends where the shell's next command begins.
    pub fn calls(&self) -> Vec<Vec<String>> {
        let joined = self.text.replace("\\\n", " ");
        let mut found = vec![];
        for line in joined.lines() {
            let words: Vec<String> = shlex::Shlex::new(line).collect();
            for command in words.split(|word| ["|", "&&", "||", ";", "&", "--", ">"].contains(&word.as_str())) {
                let at = command
                    .iter()
                    .position(|word| ["stillroom", "orchestrator", "actor", "learner"].contains(&name_of(word)));
                // The name of an image or a folder is no call.
                let Some(at) = at.filter(|&at| at == 0 || command[at - 1].contains('=') || command[at - 1] == "$(")
                else {
                    continue;
                };
                let call = command[at..].iter().map(|word| word.trim_end_matches(')').to_owned());
                found.push(call.collect());
            }
        }
        found
    }
}

/// The last part of a path.
fn name_of(word: &str) -> &str {
    word.rsplit('/').next().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn calls_of_programs_are_found_whole() {
        let text = "A=1 orchestrator up --set 'a = 1' \\\n    --run R # not --this\nls | grep orchestrator\n\
                    ./target/release/actor check > out\necho hi && learner bench\n";
        let block = Block { line: 1, info: "sh".to_owned(), text: text.to_owned() };
        let expected = ["orchestrator up --set a = 1 --run R", "./target/release/actor check", "learner bench"];
        assert_eq!(block.calls().iter().map(|call| call.join(" ")).collect::<Vec<_>>(), expected);
        assert_eq!(block.calls()[0][3], "a = 1");
    }
}
