//! Parsed sources, and what several rules ask of the syntax.

use crate::tree::ending;
use crate::{Finding, Rule, Tree};
use std::collections::BTreeMap;
use syn::Attribute;

/// Parsed files by path.
pub(crate) type Sources = BTreeMap<String, syn::File>;

/// Parses every Rust file of the tree.
pub(crate) fn parse(tree: &Tree) -> (Sources, Vec<Finding>) {
    let mut sources = Sources::new();
    let mut found = vec![];
    for (path, text) in tree.files.iter().filter(|(path, _)| ending(path) == "rs") {
        match syn::parse_file(text) {
            Ok(file) => {
                sources.insert(path.clone(), file);
            }
            Err(error) => found.push(Finding {
                path: path.clone(),
                line: error.span().start().line,
                rule: Rule::Unreadable,
                what: format!("does not parse: {error}"),
                detail: String::new(),
            }),
        }
    }
    (sources, found)
}

/// Whether an item is compiled for tests only: `#[cfg(test)]`, or a test function itself.
pub(crate) fn for_tests(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        let is_test = attribute.path().segments.last().is_some_and(|last| last.ident == "test");
        is_test || configured_for_tests(attribute)
    })
}

fn configured_for_tests(attribute: &Attribute) -> bool {
    let syn::Meta::List(list) = &attribute.meta else { return false };
    let text = list.tokens.to_string();
    let holds_test = || text.split(|c: char| !c.is_alphanumeric()).any(|word| word == "test");
    attribute.path().is_ident("cfg") && (text == "test" || text.starts_with("all") && holds_test())
}

/// An identifier's text without `r#`.
pub(crate) fn plain(ident: &proc_macro2::Ident) -> String {
    ident.to_string().trim_start_matches("r#").to_owned()
}

/// The name that an item defines in its module.
pub(crate) fn name(item: &syn::Item) -> Option<&syn::Ident> {
    Some(match item {
        syn::Item::Const(item) => &item.ident,
        syn::Item::Enum(item) => &item.ident,
        syn::Item::Fn(item) => &item.sig.ident,
        syn::Item::Static(item) => &item.ident,
        syn::Item::Struct(item) => &item.ident,
        syn::Item::Trait(item) => &item.ident,
        syn::Item::Type(item) => &item.ident,
        syn::Item::Union(item) => &item.ident,
        syn::Item::Macro(item) => item.ident.as_ref()?,
        _ => return None,
    })
}

pub(crate) fn attributes(item: &syn::Item) -> &[Attribute] {
    match item {
        syn::Item::Const(item) => &item.attrs,
        syn::Item::Enum(item) => &item.attrs,
        syn::Item::Fn(item) => &item.attrs,
        syn::Item::ForeignMod(item) => &item.attrs,
        syn::Item::Impl(item) => &item.attrs,
        syn::Item::Macro(item) => &item.attrs,
        syn::Item::Mod(item) => &item.attrs,
        syn::Item::Static(item) => &item.attrs,
        syn::Item::Struct(item) => &item.attrs,
        syn::Item::Trait(item) => &item.attrs,
        syn::Item::Type(item) => &item.attrs,
        syn::Item::Union(item) => &item.attrs,
        syn::Item::Use(item) => &item.attrs,
        _ => &[],
    }
}
