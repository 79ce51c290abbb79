//! Public items that nobody outside uses.
//!
//! Outside is another crate for what a library exposes, and another file of the crate for what only the crate can
//! reach: everything in a program, and in a library what a private module does not pass on.
//!
//! A name counts as used where another crate that names this one, or another file of the program, holds it as an
//! identifier. What the signature of a used item names is used with it. Names that are common (`new`) therefore always
//! pass; what is found is certain.

use crate::modules::{Place, Target};
use crate::paths::Reach;
use crate::syntax::{Sources, attributes, for_tests, identifiers, plain};
use crate::tree::Kind;
use crate::{Finding, Rule};
use std::collections::{BTreeMap, BTreeSet};
use syn::visit::Visit;

type Names = BTreeSet<String>;

/// An item that could be used from outside.
struct Item {
    file: String,
    line: usize,
    name: String,
    shown: String,
    /// Names that its users see with it.
    signature: Names,
    /// Whether other crates can name it.
    exposed: bool,
    /// Only a means to find `signature`, and no finding itself.
    silent: bool,
}

/// Public items without a user.
pub(crate) fn findings(targets: &[Target], sources: &Sources) -> Vec<Finding> {
    let words: BTreeMap<&str, Names> = sources.iter().map(|(path, file)| (path.as_str(), words(file))).collect();
    let mut found = vec![];
    for target in targets.iter().filter(|target| target.kind != Kind::Other) {
        let items = items(target, sources);
        let examples = examples(target, sources);
        let others = targets.iter().filter(|other| other.modules[0].file != target.modules[0].file);
        let users: Vec<&Target> = others.filter(|other| holds(other, &words, &target.name)).collect();
        let outside = |item: &Item| {
            if item.exposed {
                users.iter().any(|user| holds(user, &words, &item.name)) || examples.contains(&item.name)
            } else {
                files(target).into_iter().any(|file| file != item.file && has(&words, file, &item.name))
            }
        };
        let mut used: Vec<bool> = items.iter().map(outside).collect();
        spread(&items, &mut used);
        // A file that another package takes in, too, is judged in its own.
        let root = &target.modules[0].file;
        let home = &root[..root.find("src/").unwrap_or(0)];
        let unused = items.into_iter().zip(used);
        let unused = unused.filter(|(item, used)| !used && !item.silent && item.file.starts_with(home));
        found.extend(unused.map(|(item, _)| Finding {
            path: item.file,
            line: item.line,
            rule: Rule::UnusedPub,
            what: format!("nobody outside uses `{}`", item.shown),
            detail: String::new(),
        }));
    }
    found
}

/// What a used item's signature names is used.
fn spread(items: &[Item], used: &mut [bool]) {
    let mut open: Vec<usize> = (0..items.len()).filter(|&index| used[index]).collect();
    while let Some(index) = open.pop() {
        for (other, item) in items.iter().enumerate() {
            if !used[other] && items[index].signature.contains(&item.name) {
                used[other] = true;
                open.push(other);
            }
        }
    }
}

fn files(target: &Target) -> BTreeSet<&str> {
    target.modules.iter().map(|module| module.file.as_str()).collect()
}

fn has(words: &BTreeMap<&str, Names>, file: &str, name: &str) -> bool {
    words.get(file).is_some_and(|words| words.contains(name))
}

fn holds(target: &Target, words: &BTreeMap<&str, Names>, name: &str) -> bool {
    files(target).into_iter().any(|file| has(words, file, name))
}

/// The words of a library's examples in its documentation, which are crates of their own.
fn examples(target: &Target, sources: &Sources) -> Names {
    let mut found = Names::new();
    for file in files(target).into_iter().filter_map(|file| sources.get(file)) {
        let mut docs = Docs::default();
        docs.visit_file(file);
        found.append(&mut docs.words);
    }
    found
}

#[derive(Default)]
struct Docs {
    words: Names,
    code: bool,
}

impl<'a> Visit<'a> for Docs {
    fn visit_attribute(&mut self, attribute: &'a syn::Attribute) {
        let syn::Meta::NameValue(value) = &attribute.meta else { return };
        let syn::Expr::Lit(syn::ExprLit { lit: syn::Lit::Str(text), .. }) = &value.value else { return };
        if !attribute.path().is_ident("doc") {
            return;
        }
        for line in text.value().lines() {
            if line.trim_start().starts_with("```") {
                self.code = !self.code;
            } else if self.code {
                self.words.extend(split(line));
            }
        }
    }
}

fn split(text: &str) -> impl Iterator<Item = String> {
    text.split(|c: char| !c.is_alphanumeric() && c != '_').filter(|word| !word.is_empty()).map(str::to_owned)
}

/// All identifiers of a file.
fn words(file: &syn::File) -> Names {
    let mut words = Words::default();
    words.visit_file(file);
    words.0
}

#[derive(Default)]
struct Words(Names);

impl<'a> Visit<'a> for Words {
    fn visit_ident(&mut self, ident: &'a syn::Ident) {
        self.0.insert(plain(ident));
    }

    fn visit_macro(&mut self, called: &'a syn::Macro) {
        syn::visit::visit_macro(self, called);
        self.0.extend(identifiers(called.tokens.clone()));
    }

    fn visit_attribute(&mut self, attribute: &'a syn::Attribute) {
        syn::visit::visit_attribute(self, attribute);
        if let syn::Meta::List(list) = &attribute.meta {
            self.0.extend(identifiers(list.tokens.clone()));
            // `#[serde(with = "module::function")]`
            self.0.extend(split(&list.tokens.to_string()));
        }
    }
}

fn names(visit: impl FnOnce(&mut Words)) -> Names {
    let mut words = Words::default();
    visit(&mut words);
    words.0
}

/// The public items of a crate's files, and what ties their signatures together.
fn items(target: &Target, sources: &Sources) -> Vec<Item> {
    let mut found = vec![];
    for (index, module) in target.modules.iter().enumerate().filter(|(_, module)| !module.test && !module.inline) {
        let Some(file) = sources.get(&module.file) else { continue };
        // A method is where its type is, in whatever file it is written.
        let exposed = |name: &str| match target.resolve(index, &[name.to_owned()]) {
            Some(Place::Item(at)) => target.kind == Kind::Library && target.is_exposed(at, name),
            _ => target.kind == Kind::Library && target.is_exposed(index, name),
        };
        let first = found.len();
        for item in file.items.iter().filter(|item| !for_tests(attributes(item))) {
            match item {
                syn::Item::Impl(block) => of_impl(&module.file, block, &mut found),
                item => found.extend(of_item(&module.file, item)),
            }
        }
        for item in &mut found[first..] {
            item.exposed = exposed(item.shown.split("::").next().unwrap_or_default());
        }
        let renamed = module
            .uses
            .iter()
            .filter(|used| used.reach != Reach::Module && !used.glob && used.path.last() != Some(&used.name));
        found.extend(renamed.map(|used| Item {
            file: module.file.clone(),
            line: used.line,
            name: used.name.clone(),
            shown: used.name.clone(),
            signature: used.path.last().cloned().into_iter().collect(),
            exposed: used.reach == Reach::World && target.kind == Kind::Library,
            silent: true,
        }));
    }
    found
}

fn of_item(file: &str, item: &syn::Item) -> Option<Item> {
    let (vis, ident, signature) = match item {
        syn::Item::Const(item) => (&item.vis, &item.ident, names(|words| words.visit_type(&item.ty))),
        syn::Item::Static(item) => (&item.vis, &item.ident, names(|words| words.visit_type(&item.ty))),
        syn::Item::Enum(item) => (&item.vis, &item.ident, names(|words| words.visit_item_enum(item))),
        syn::Item::Fn(item) => (&item.vis, &item.sig.ident, names(|words| words.visit_signature(&item.sig))),
        syn::Item::Trait(item) => (&item.vis, &item.ident, names(|words| words.visit_item_trait(item))),
        syn::Item::Type(item) => (&item.vis, &item.ident, names(|words| words.visit_item_type(item))),
        syn::Item::Struct(item) => {
            let public = |field: &&syn::Field| matches!(field.vis, syn::Visibility::Public(_));
            let signature = names(|words| {
                words.visit_generics(&item.generics);
                item.fields.iter().filter(public).for_each(|field| words.visit_field(field));
            });
            (&item.vis, &item.ident, signature)
        }
        syn::Item::Macro(item) => {
            let ident = item.ident.as_ref()?;
            let line = ident.span().start().line;
            let name = plain(ident);
            let signature = identifiers(item.mac.tokens.clone()).into_iter().collect();
            let silent = !item.attrs.iter().any(|attribute| attribute.path().is_ident("macro_export"));
            return (!silent).then(|| Item {
                file: file.to_owned(),
                line,
                shown: name.clone(),
                name,
                signature,
                exposed: false,
                silent,
            });
        }
        _ => return None,
    };
    let exported = attributes(item).iter().any(|attribute| attribute.path().is_ident("unsafe"));
    let public = matches!(vis, syn::Visibility::Public(_)) && !exported;
    public.then(|| new(file, ident, None, signature))
}

fn of_impl(file: &str, block: &syn::ItemImpl, found: &mut Vec<Item>) {
    let syn::Type::Path(owner) = &*block.self_ty else { return };
    let Some(owner) = owner.path.segments.last().map(|last| plain(&last.ident)) else { return };
    if let Some((_, of, _)) = &block.trait_ {
        // Who uses the type uses what its traits hand out.
        let signature = names(|words| {
            words.visit_path(of);
            for item in &block.items {
                if let syn::ImplItem::Type(item) = item {
                    words.visit_type(&item.ty);
                }
            }
        });
        let line = block.impl_token.span.start().line;
        found.push(Item {
            file: file.to_owned(),
            line,
            shown: owner.clone(),
            name: owner,
            signature,
            exposed: false,
            silent: true,
        });
        return;
    }
    for item in &block.items {
        let (vis, ident, signature, attributes) = match item {
            syn::ImplItem::Fn(item) => {
                (&item.vis, &item.sig.ident, names(|words| words.visit_signature(&item.sig)), &item.attrs)
            }
            syn::ImplItem::Const(item) => {
                (&item.vis, &item.ident, names(|words| words.visit_type(&item.ty)), &item.attrs)
            }
            _ => continue,
        };
        if matches!(vis, syn::Visibility::Public(_)) && !for_tests(attributes) {
            found.push(new(file, ident, Some(&owner), signature));
        }
    }
}

fn new(file: &str, ident: &syn::Ident, owner: Option<&str>, signature: Names) -> Item {
    let name = plain(ident);
    let shown = owner.map_or_else(|| name.clone(), |owner| format!("{owner}::{name}"));
    Item {
        file: file.to_owned(),
        line: ident.span().start().line,
        name,
        shown,
        signature,
        exposed: false,
        silent: false,
    }
}
