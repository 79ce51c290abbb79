//! Public functions and constants of a library that nobody outside uses; rustc sees those that no other crate can name.
//!
//! A name counts as used where a file of another crate, or an example in the library's documentation, holds it as a
//! word. Names that are common (`new`) therefore always pass; what is found is certain.

use crate::modules::{Place, Target};
use crate::syntax::{Sources, attributes, for_tests, plain};
use crate::{Finding, Rule, Tree};
use std::collections::BTreeSet;

/// A function or constant that is declared `pub`.
struct Item {
    line: usize,
    /// The type that it belongs to.
    owner: Option<String>,
    name: String,
}

/// Public items without a user.
pub(crate) fn findings(tree: &Tree, targets: &[Target], sources: &Sources) -> Vec<Finding> {
    let words: Vec<(&String, BTreeSet<&str>)> =
        sources.keys().map(|path| (path, words(code(&tree.files[path])))).collect();
    let mut found = vec![];
    for target in targets.iter().filter(|target| target.is_library) {
        let own: BTreeSet<&String> = target.modules.iter().map(|module| &module.file).collect();
        let examples: BTreeSet<&str> = own.iter().flat_map(|path| words_of_examples(&tree.files[*path])).collect();
        let is_used = |name: &str| {
            examples.contains(name) || words.iter().any(|(path, words)| !own.contains(path) && words.contains(name))
        };
        for (index, module) in target.modules.iter().enumerate().filter(|(_, module)| !module.test && !module.inline) {
            let Some(file) = sources.get(&module.file) else { continue };
            for Item { line, owner, name } in items(file) {
                // A method is where its type is, in whatever file it is written.
                let first = owner.as_ref().unwrap_or(&name);
                let at = match target.resolve(index, std::slice::from_ref(first)) {
                    Some(Place::Item(at)) => at,
                    _ => index,
                };
                if target.is_exposed(at, first) && !is_used(&name) {
                    let shown = owner.map_or_else(|| name.clone(), |owner| format!("{owner}::{name}"));
                    found.push(Finding {
                        path: module.file.clone(),
                        line,
                        rule: Rule::UnusedPub,
                        what: format!("nobody outside uses `{shown}`"),
                        detail: String::new(),
                    });
                }
            }
        }
    }
    found
}

fn words<'a>(lines: impl Iterator<Item = &'a str>) -> BTreeSet<&'a str> {
    lines.flat_map(|line| line.split(|c: char| !c.is_alphanumeric() && c != '_')).collect()
}

fn code(text: &str) -> impl Iterator<Item = &str> {
    text.lines().filter(|line| !line.trim_start().starts_with("//"))
}

/// The words of blocks of code in documentation.
fn words_of_examples(text: &str) -> BTreeSet<&str> {
    let mut is_code = false;
    let docs = text.lines().filter_map(|line| {
        let line = line.trim_start();
        line.strip_prefix("//!").or_else(|| line.strip_prefix("///"))
    });
    words(docs.filter(move |line| {
        is_code ^= line.trim_start().starts_with("```");
        is_code
    }))
}

fn items(file: &syn::File) -> Vec<Item> {
    let mut found = vec![];
    let mut add = |vis: &syn::Visibility, ident: &syn::Ident, attributes: &[syn::Attribute], owner: Option<&String>| {
        // `#[unsafe(no_mangle)]`: others call it by its symbol.
        let is_exported = attributes.iter().any(|attribute| attribute.path().is_ident("unsafe"));
        if matches!(vis, syn::Visibility::Public(_)) && !is_exported && !for_tests(attributes) {
            found.push(Item { line: ident.span().start().line, owner: owner.cloned(), name: plain(ident) });
        }
    };
    for item in file.items.iter().filter(|item| !for_tests(attributes(item))) {
        match item {
            syn::Item::Fn(item) => add(&item.vis, &item.sig.ident, &item.attrs, None),
            syn::Item::Const(item) => add(&item.vis, &item.ident, &item.attrs, None),
            syn::Item::Impl(block) if block.trait_.is_none() => {
                let syn::Type::Path(owner) = &*block.self_ty else { continue };
                let owner = owner.path.segments.last().map(|last| plain(&last.ident));
                for item in &block.items {
                    match item {
                        syn::ImplItem::Fn(item) => add(&item.vis, &item.sig.ident, &item.attrs, owner.as_ref()),
                        syn::ImplItem::Const(item) => add(&item.vis, &item.ident, &item.attrs, owner.as_ref()),
                        _ => {}
                    }
                }
            }
            _ => {}
        }
    }
    found
}
