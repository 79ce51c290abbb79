//! Tests that assert nothing.
//!
//! A test asserts by an assertion's macro, `?`, `should_panic`, an error that it expects, a result that it unwraps and
//! has no other use for, or a helper among the tests of its crate that asserts. Assertions in the code under test are
//! none of the test's.

use crate::modules::Target;
use crate::tree::{Kind, ending};
use crate::{Finding, Rule, Tree};
use proc_macro2::{Delimiter, TokenStream, TokenTree};
use std::collections::{BTreeMap, BTreeSet};

/// Beginnings of the names of macros that assert.
const MACROS: [&str; 5] = ["assert", "debug_assert", "prop_assert", "panic", "unreachable"];
/// Where libraries for tests lie.
const TESTS: &str = "tests/";

/// A function, as its tokens.
struct Function {
    name: String,
    line: usize,
    /// Whether it is a test, and not a helper or what is tested.
    is_test: bool,
    /// Whether it is compiled for tests only.
    for_tests: bool,
    should_panic: bool,
    body: TokenStream,
}

/// Tests without an assertion.
pub(crate) fn findings(tree: &Tree, targets: &[Target]) -> Vec<Finding> {
    let sources = tree.files.iter().filter(|(path, _)| ending(path) == "rs");
    let functions: BTreeMap<&str, Vec<Function>> =
        sources.filter_map(|(path, text)| Some((path.as_str(), functions(text.parse().ok()?, false)))).collect();
    let shared = targets.iter().filter(|target| target.kind == Kind::Library && serves_tests(target));
    let shared: Vec<&Function> = shared.flat_map(|target| helpers(target, &functions)).collect();
    let mut found = vec![];
    for target in targets {
        let asserting = asserting(&helpers(target, &functions), &shared);
        let files: BTreeSet<&str> = target.modules.iter().map(|module| module.file.as_str()).collect();
        for file in files {
            let tests = functions.get(file).into_iter().flatten().filter(|function| function.is_test);
            let empty = tests.filter(|test| !test.should_panic && !test_asserts(test, &asserting));
            found.extend(empty.map(|test| Finding {
                path: file.to_owned(),
                line: test.line,
                rule: Rule::EmptyTest,
                what: format!("the test `{}` asserts nothing", test.name),
                detail: String::new(),
            }));
        }
    }
    found
}

/// Whether all of a crate is for tests.
fn serves_tests(target: &Target) -> bool {
    target.kind == Kind::Other || target.modules[0].file.starts_with(TESTS)
}

/// The functions of a crate that are for tests only.
fn helpers<'a>(target: &Target, functions: &'a BTreeMap<&str, Vec<Function>>) -> Vec<&'a Function> {
    let mut found = vec![];
    for module in target.modules.iter().filter(|module| !module.inline) {
        let whole = serves_tests(target) || module.test;
        let here = functions.get(module.file.as_str()).into_iter().flatten();
        found.extend(here.filter(|function| whole || function.for_tests));
    }
    found
}

/// The names of helpers that assert, by themselves or through another one.
fn asserting(own: &[&Function], shared: &[&Function]) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    loop {
        let before = found.len();
        for helper in own.iter().chain(shared).filter(|helper| !helper.is_test) {
            if asserts(&helper.body, &found) {
                found.insert(helper.name.clone());
            }
        }
        if found.len() == before {
            return found;
        }
    }
}

fn test_asserts(test: &Function, helpers: &BTreeSet<String>) -> bool {
    asserts(&test.body, helpers) || passes_on_errors(&test.body) || unwraps_for_its_own_sake(&test.body)
}

/// Whether code calls an assertion's macro, expects an error, or calls a helper that asserts.
fn asserts(body: &TokenStream, helpers: &BTreeSet<String>) -> bool {
    let tokens: Vec<TokenTree> = body.clone().into_iter().collect();
    tokens.iter().enumerate().any(|(index, token)| match token {
        TokenTree::Group(group) => asserts(&group.stream(), helpers),
        TokenTree::Ident(ident) => {
            let name = ident.to_string();
            let macro_call = is_punct(tokens.get(index + 1), '!') && MACROS.iter().any(|begin| name.starts_with(begin));
            let call = matches!(tokens.get(index + 1), Some(TokenTree::Group(group)) if group.delimiter() == Delimiter::Parenthesis);
            macro_call || call && (name == "expect_err" || name == "unwrap_err" || helpers.contains(&name))
        }
        _ => false,
    })
}

/// Whether code ends with an error where one occurs.
fn passes_on_errors(body: &TokenStream) -> bool {
    body.clone().into_iter().any(|token| match token {
        TokenTree::Group(group) => passes_on_errors(&group.stream()),
        token => is_punct(Some(&token), '?'),
    })
}

/// Whether a statement unwraps a result and drops the value. The standard library's results are none of the test's.
fn unwraps_for_its_own_sake(body: &TokenStream) -> bool {
    let tokens: Vec<TokenTree> = body.clone().into_iter().collect();
    let inner = tokens.iter().any(|token| match token {
        TokenTree::Group(group) if group.delimiter() == Delimiter::Brace => unwraps_for_its_own_sake(&group.stream()),
        _ => false,
    });
    inner
        || tokens.split(|token| is_punct(Some(token), ';')).any(|statement| {
            let [.., dot, TokenTree::Ident(last), TokenTree::Group(_)] = statement else { return false };
            let unwrapped = is_punct(Some(dot), '.') && (last == "expect" || last == "unwrap");
            let kept = statement.iter().any(|token| is_punct(Some(token), '='));
            let first = statement.first().map(ToString::to_string).unwrap_or_default();
            unwrapped && !kept && first != "let" && first != "std" && first != "fs"
        })
}

fn is_punct(token: Option<&TokenTree>, wanted: char) -> bool {
    matches!(token, Some(TokenTree::Punct(punct)) if punct.as_char() == wanted)
}

/// All functions among tokens, also those in the arguments of a macro (`proptest!`).
fn functions(tokens: TokenStream, for_tests: bool) -> Vec<Function> {
    let mut found = vec![];
    let mut attributes: Vec<String> = vec![];
    let mut named: Option<(String, usize)> = None;
    let mut tokens = tokens.into_iter().peekable();
    while let Some(token) = tokens.next() {
        match token {
            TokenTree::Punct(punct) if punct.as_char() == '#' => {
                if let Some(TokenTree::Group(group)) = tokens.next_if(|next| matches!(next, TokenTree::Group(_))) {
                    attributes.push(group.stream().to_string());
                }
            }
            TokenTree::Punct(punct) if punct.as_char() == ';' => {
                attributes.clear();
                named = None;
            }
            TokenTree::Ident(ident) if ident == "fn" => {
                if let Some(TokenTree::Ident(name)) = tokens.peek() {
                    named = Some((name.to_string(), name.span().start().line));
                }
            }
            TokenTree::Group(group) if group.delimiter() == Delimiter::Brace => {
                let test = |text: &String| text == "test" || text.ends_with(":: test") || text.starts_with("test ");
                let is_test = attributes.iter().any(test);
                let for_tests = for_tests || is_test || attributes.iter().any(|text| text == "cfg (test)");
                let should_panic = attributes.iter().any(|text| text.starts_with("should_panic"));
                attributes.clear();
                match named.take() {
                    Some((name, line)) => {
                        found.push(Function { name, line, is_test, for_tests, should_panic, body: group.stream() });
                    }
                    None => found.append(&mut functions(group.stream(), for_tests)),
                }
            }
            _ => {}
        }
    }
    found
}
