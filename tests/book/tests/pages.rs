//! The book is whole: its pages are in the summary, what they copy is as its source, their commands say whether they are
//! run, and the page of all settings is what the types say.

use book::{Block, How, Types, links, pages, settings_page, source};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

#[test]
fn the_summary_names_every_page_once() {
    let root = root();
    let named: Vec<String> = pages(&root).unwrap().into_iter().map(|page| page.path).collect();
    let mut there: BTreeSet<String> = BTreeSet::new();
    for entry in std::fs::read_dir(root.join("docs")).unwrap() {
        let name = entry.unwrap().file_name().to_string_lossy().into_owned();
        if Path::new(&name).extension().is_some_and(|extension| extension == "md") && name != "SUMMARY.md" {
            there.insert(name);
        }
    }
    assert_eq!(named.iter().cloned().collect::<BTreeSet<_>>(), there, "pages in docs/SUMMARY.md, and in docs/");
    assert_eq!(named.len(), there.len(), "a page is named twice");
}

#[test]
fn a_page_begins_with_its_title_and_closes_its_blocks() {
    for page in pages(&root()).unwrap() {
        assert!(page.text.starts_with("# "), "{}: the first line is no heading", page.path);
        let fences = page.text.lines().filter(|line| line.trim_start().starts_with("```")).count();
        assert_eq!(fences % 2, 0, "{}: a block of code is not closed", page.path);
        assert!(!page.title.is_empty(), "{} has no title in the summary", page.path);
    }
}

/// The README is no page of the book, but its commands are as much promised.
#[test]
fn every_block_of_commands_says_whether_it_is_run() {
    let root = root();
    let mut blocks: Vec<(String, Block)> = vec![];
    for page in pages(&root).unwrap() {
        blocks.extend(page.blocks().into_iter().map(|block| (page.path.clone(), block)));
    }
    let mut unsaid = vec![];
    for (path, block) in &blocks {
        let known = ["sh", "text", "toml", "rust", "python", "diff", ""].contains(&block.language());
        let is_run = ["sh", "python"].contains(&block.language());
        if !known || is_run && block.how() == How::Unsaid {
            unsaid.push(format!("docs/{path}:{}: ```{}", block.line, block.info));
        }
    }
    let reasons: Vec<&str> = book::REASONS.iter().map(|(reason, _)| *reason).collect();
    assert!(
        unsaid.is_empty(),
        "commands are marked `sh,run`, `sh,run=small` or `sh,norun=REASON` ({}); other blocks are text, toml, rust, \
         python or diff:\n{}",
        reasons.join(", "),
        unsaid.join("\n")
    );
    let run = blocks.iter().filter(|(_, block)| matches!(block.how(), How::Run | How::RunSmall)).count();
    assert!(run > 15, "only {run} blocks are run");
}

#[test]
fn blocks_of_toml_are_toml() {
    for page in pages(&root()).unwrap() {
        for block in page.blocks().into_iter().filter(|block| block.language() == "toml") {
            let parsed: Result<toml::Table, _> = block.text.parse();
            assert!(parsed.is_ok(), "docs/{}:{}: {}", page.path, block.line, parsed.unwrap_err());
        }
    }
}

/// Copied and not included, so that a page is whole where nothing renders it.
#[test]
fn a_copied_block_is_as_its_source() {
    let root = root();
    let mut copies = 0;
    for page in pages(&root).unwrap() {
        for block in page.blocks() {
            let Some(from) = block.from() else { continue };
            let source = source(&root, &page.path, from).unwrap();
            assert_eq!(block.text, source, "docs/{}:{} is not as {from}", page.path, block.line);
            copies += 1;
        }
        assert!(!page.text.contains("{{#"), "docs/{}: nothing fills this in on a code host", page.path);
    }
    assert!(copies >= 1, "{copies} blocks were compared");
}

/// What a `diff` changes stands in the sources: context and removed lines, one after the other. `git apply` takes it.
#[test]
fn every_diff_fits_the_sources() {
    let root = root();
    let mut hunks = 0;
    for page in pages(&root).unwrap() {
        for block in page.blocks().into_iter().filter(|block| block.language() == "diff") {
            let mut source = String::new();
            let place = format!("docs/{}:{}", page.path, block.line);
            for hunk in block.text.split("\n@@").enumerate().map(|(index, text)| (index, text.to_owned())) {
                let (index, text) = hunk;
                if index == 0 {
                    let path = text.lines().find_map(|line| line.strip_prefix("--- a/"));
                    let path = path.unwrap_or_else(|| panic!("{place}: no line `--- a/PATH`"));
                    source = std::fs::read_to_string(root.join(path)).unwrap_or_else(|error| panic!("{path}: {error}"));
                    continue;
                }
                let old = text.lines().skip(1).filter(|line| !line.starts_with('+'));
                let old: Vec<&str> = old.map(|line| line.get(1..).unwrap_or_default()).collect();
                let old = old.join("\n") + "\n";
                assert!(source.contains(&old), "{place}: not in the source:\n{old}");
                hunks += 1;
            }
            let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join("own-parts.diff");
            std::fs::write(&file, &block.text).unwrap();
            let git = Command::new("git").args(["apply", "--check"]).arg(&file).current_dir(&root).output().unwrap();
            assert!(git.status.success(), "{place}: {}", String::from_utf8_lossy(&git.stderr));
        }
    }
    assert!(hunks >= 6, "{hunks} hunks were compared");
}

#[test]
fn the_page_of_all_settings_is_what_the_types_say() {
    let root = root();
    let expected = settings_page(&Types::below(&root.join("proto/src")).unwrap()).unwrap();
    let is = std::fs::read_to_string(root.join("docs/settings.md")).unwrap_or_default();
    if is != expected {
        let new = root.join("target/settings.md");
        std::fs::write(&new, &expected).unwrap();
        let differs = is.lines().zip(expected.lines()).find(|(is, expected)| is != expected);
        panic!("docs/settings.md is not what the types say ({differs:?}): cp target/settings.md docs/settings.md");
    }
}

/// A range is values, and no sentence about others. What leads to a section leads to one that has the key.
#[test]
fn the_page_of_all_settings_says_what_a_key_can_be_and_where_it_is() {
    let page = settings_page(&Types::below(&root().join("proto/src")).unwrap()).unwrap();
    for line in [
        "* `frames` = `20000000`, then `25000000` (at least 1 and at most 1000000000000000): Frames",
        "* `failures_only` = `false` (false unless recording.depth_share is 0): Only",
        "* `count` = `1` (1 to actors.count): Learner",
    ] {
        assert!(page.contains(line), "{line}");
    }
    let named: Vec<(String, String)> = links(page.split("\n## ").next().unwrap());
    assert!(named.len() >= 8, "{named:?}");
    for (keys, place) in named {
        let section = page.split("\n## ").find(|section| {
            let letters = |letter: char| letter.is_alphanumeric() || letter == ' ';
            let heading: String = section.lines().next().unwrap().chars().filter(|&letter| letters(letter)).collect();
            format!("#{}", heading.to_lowercase().replace(' ', "-")) == place
        });
        let section = section.unwrap_or_else(|| panic!("no section {place}"));
        for key in keys.split(", ").map(|key| key.trim_matches('`')).filter(|key| *key != "stages") {
            let name = key.rsplit('.').next().unwrap();
            assert!(section.contains(&format!("\n* `{name}`")), "{key} is not in {place}");
        }
    }
}

/// Nothing is left out: every key that `orchestrator config` prints has a line in its section.
#[test]
fn every_key_of_the_configuration_is_on_the_page() {
    let page = settings_page(&Types::below(&root().join("proto/src")).unwrap()).unwrap();
    let table: toml::Table = proto::config::Config::default().to_toml().parse().unwrap();
    let mut pending: Vec<(String, toml::Value)> = vec![(String::new(), table.into())];
    let mut keys = 0;
    while let Some((path, value)) = pending.pop() {
        let inner: Vec<(String, toml::Value)> = match value {
            toml::Value::Table(table) => table.into_iter().collect(),
            toml::Value::Array(list) if list.first().is_some_and(toml::Value::is_table) => {
                list[0].as_table().unwrap().clone().into_iter().collect()
            }
            _ => continue,
        };
        let heading = match path.as_str() {
            "" => "## At the top".to_owned(),
            "stages" => "## `[[stages]]`".to_owned(),
            path => format!("## `[{path}]`"),
        };
        let section = page.split(&format!("{heading}\n")).nth(1).unwrap_or_else(|| panic!("no section {heading}"));
        let section = section.split("\n## ").next().unwrap();
        for (name, value) in inner {
            let key = if path.is_empty() { name.clone() } else { format!("{path}.{name}") };
            let is_table = value.is_table() || value.as_array().and_then(|list| list.first()?.as_table()).is_some();
            if is_table {
                pending.push((key, value));
            } else {
                assert!(section.contains(&format!("\n* `{name}`")), "{key} is not on the page");
                keys += 1;
            }
        }
    }
    assert!(keys > 50, "{keys} keys were looked for");
}

#[test]
fn another_comment_or_field_makes_another_page() {
    let mut types = Types::below(&root().join("proto/src")).unwrap();
    let before = settings_page(&types).unwrap();
    types.add("/// Checks.\npub struct CheckpointConfig {\n/// Each hour.\npub interval_s: f64,\n/// New.\npub fresh: u32 }").unwrap();
    let after = settings_page(&types).unwrap();
    assert!(!before.contains("Each hour.") && after.contains(": Each hour.\n"));
    assert!(after.contains("\n* `fresh`: New.\n") && !after.contains("Newest checkpoints to keep"));
    assert_eq!(links("[a](b)"), [("a".to_owned(), "b".to_owned())]);
}
