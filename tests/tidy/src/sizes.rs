//! Lengths of functions and files.

use crate::syntax::Sources;
use crate::tree::ending;
use crate::{Finding, Rule, Tree};
use syn::visit::Visit;

/// The most lines of a function, from its signature to its closing brace.
const FUNCTION_LINES: usize = 80;
/// The most lines of a source file.
const FILE_LINES: usize = 600;
/// What names the reason of a longer function, in a comment directly above it.
const REASON: &str = "Long because: ";
/// Endings of sources that are written by hand.
const SOURCES: [&str; 7] = ["rs", "py", "cpp", "cu", "h", "c", "proto"];

/// Functions and files that are too long.
pub(crate) fn findings(tree: &Tree, sources: &Sources) -> Vec<Finding> {
    let mut found = vec![];
    for (path, text) in &tree.files {
        let lines = text.lines().count();
        if lines > FILE_LINES && SOURCES.contains(&ending(path)) {
            found.push(Finding {
                path: path.clone(),
                line: 1,
                rule: Rule::LongFile,
                what: format!("file of more than {FILE_LINES} lines"),
                detail: String::new(),
            });
        }
        let lines: Vec<&str> = text.lines().collect();
        let mut measure = Measure { path, lines: &lines, found: &mut found };
        if let Some(file) = sources.get(path) {
            measure.visit_file(file);
        } else {
            match ending(path) {
                "py" => measure.python(),
                "c" | "cpp" | "cu" | "h" => measure.c(),
                _ => {}
            }
        }
    }
    found
}

struct Measure<'a> {
    path: &'a str,
    lines: &'a [&'a str],
    found: &'a mut Vec<Finding>,
}

impl Measure<'_> {
    fn function(&mut self, signature: &syn::Signature, body: &syn::Block) {
        let first = signature.fn_token.span.start().line;
        let last = body.brace_token.span.close().end().line;
        self.judge(&signature.ident.to_string(), first, last);
    }

    /// A function of Python ends before the next line that stands no further in.
    fn python(&mut self) {
        let indent = |line: &str| line.len() - line.trim_start().len();
        for (index, line) in self.lines.iter().enumerate() {
            let Some(head) = line.trim_start().strip_prefix("def ") else { continue };
            let after = self.lines[index + 1..].iter().enumerate();
            let within =
                after.take_while(|(_, next)| next.is_empty() || next.starts_with(')') || indent(next) > indent(line));
            let last = within.filter(|(_, next)| !next.is_empty()).last().map_or(0, |(ahead, _)| ahead + 1);
            self.judge(head.split('(').next().unwrap_or_default(), index + 1, index + 1 + last);
        }
    }

    /// A function of C, C++ or CUDA, a lambda too: from its head, which ends in a brace, to the brace at the head's
    /// indent. That holds for sources as clang-format lays them out; preprocessor lines are passed over.
    fn c(&mut self) {
        let indent = |line: &str| line.len() - line.trim_start().len();
        for (index, line) in self.lines.iter().enumerate() {
            if !line.trim_end().ends_with('{') || line.trim_start().starts_with('#') {
                continue;
            }
            let goes_on = |line: &&str| {
                let line = line.trim();
                !line.is_empty() && !line.starts_with(['#', '/']) && !line.ends_with([';', '{', '}', ':'])
            };
            let first = index - self.lines[..index].iter().rev().take_while(|line| goes_on(line)).count();
            let head = self.lines[first..=index].join(" ");
            let Some(name) = name_in_c(&head) else { continue };
            let depth = indent(self.lines[first]);
            let ends = |line: &&str| line.trim_start().starts_with('}') && indent(line) == depth;
            let Some(length) = self.lines[index + 1..].iter().position(ends) else { continue };
            self.judge(name, first + 1, index + 2 + length);
        }
    }

    fn judge(&mut self, name: &str, first: usize, last: usize) {
        if last + 1 - first > FUNCTION_LINES && !self.has_reason(first) {
            self.found.push(Finding {
                path: self.path.to_owned(),
                line: first,
                rule: Rule::LongFunction,
                what: format!("`{name}` has more than {FUNCTION_LINES} lines"),
                detail: String::new(),
            });
        }
    }

    /// Looks through the comments and attributes directly above a line, counted from 1.
    fn has_reason(&self, line: usize) -> bool {
        let above = self.lines[..line - 1].iter().rev().map(|line| line.trim_start());
        let reason = |line: &str| line.trim_start_matches(['/', '#', ' ']).strip_prefix(REASON).map(str::to_owned);
        above
            .take_while(|line| line.starts_with("//") || line.starts_with('#'))
            .any(|line| reason(line).is_some_and(|reason| !reason.trim().is_empty()))
    }
}

/// The name in a function's head: the last before the first parenthesis, but for attributes such as
/// `__launch_bounds__`; `lambda` where there is none. Other blocks have no name.
fn name_in_c(head: &str) -> Option<&str> {
    let named =
        |text: &str| text.rfind(|letter: char| !letter.is_alphanumeric() && letter != '_').map_or(0, |at| at + 1);
    let mut names = head.match_indices('(').map(|(at, _)| head[..at].trim_end()).map(|text| &text[named(text)..]);
    let name = names.find(|name| !name.starts_with("__"))?;
    match name {
        "if" | "for" | "while" | "switch" | "catch" => None,
        "" => Some("lambda"),
        name => Some(name),
    }
}

impl<'a> Visit<'a> for Measure<'_> {
    fn visit_item_fn(&mut self, item: &'a syn::ItemFn) {
        self.function(&item.sig, &item.block);
        syn::visit::visit_item_fn(self, item);
    }

    fn visit_impl_item_fn(&mut self, item: &'a syn::ImplItemFn) {
        self.function(&item.sig, &item.block);
        syn::visit::visit_impl_item_fn(self, item);
    }

    fn visit_trait_item_fn(&mut self, item: &'a syn::TraitItemFn) {
        if let Some(body) = &item.default {
            self.function(&item.sig, body);
        }
        syn::visit::visit_trait_item_fn(self, item);
    }
}
