//! The modules of a crate, what each defines and imports, and where a path leads.

use crate::paths::{Mention, Reader, Use};
use crate::syntax::{Sources, attributes, for_tests, name, plain};
use std::collections::{BTreeMap, BTreeSet};

/// How many re-exports a name is followed through.
const MOST_STEPS: usize = 24;

/// One module: a file, or a block in a file.
#[derive(Debug, Default)]
pub(crate) struct Module {
    pub file: String,
    /// Whether it is compiled for tests only.
    pub test: bool,
    /// The module that declares it.
    pub parent: Option<usize>,
    /// Modules that it declares.
    pub children: BTreeMap<String, usize>,
    pub items: BTreeSet<String>,
    /// Names that it imports or passes on.
    pub uses: Vec<Use>,
    /// Paths in its code.
    pub mentions: Vec<Mention>,
}

/// A crate with its modules; the first is the root.
#[derive(Debug)]
pub(crate) struct Target {
    pub modules: Vec<Module>,
}

/// Where a path leads inside a crate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Place {
    Module(usize),
    /// To an item that this module defines.
    Item(usize),
}

impl Target {
    /// Reads a crate from its root file on.
    pub(crate) fn load(root: &str, sources: &Sources) -> Self {
        let mut target = Self { modules: vec![] };
        let module = Module { file: root.to_owned(), ..Module::default() };
        let (folder, _) = root.rsplit_once('/').unwrap_or_default();
        target.modules.push(module);
        if let Some(file) = sources.get(root) {
            target.read(0, &file.items, folder, sources);
        }
        target
    }

    /// Reads a module's items; `folder` is where the files of its children lie.
    fn read(&mut self, at: usize, items: &[syn::Item], folder: &str, sources: &Sources) {
        for item in items {
            let test = self.modules[at].test || for_tests(attributes(item));
            if let syn::Item::Mod(item) = item {
                self.child(at, item, test, folder, sources);
                continue;
            }
            if matches!(item, syn::Item::Macro(item) if item.mac.path.is_ident("include")) {
                self.listed(at, folder, sources);
            }
            if let Some(name) = name(item) {
                self.modules[at].items.insert(plain(name));
            }
            let mut reader = Reader::new(test);
            reader.read(item);
            self.modules[at].uses.append(&mut reader.uses);
            self.modules[at].mentions.append(&mut reader.mentions);
        }
    }

    /// Reads the folders beside a module that includes what a build script wrote: it lists them as modules.
    fn listed(&mut self, parent: usize, folder: &str, sources: &Sources) {
        let below =
            sources.keys().filter_map(|path| path.strip_prefix(folder)?.strip_prefix('/')?.strip_suffix("/mod.rs"));
        for name in below.filter(|name| !name.contains('/')) {
            let item = syn::parse_str(&format!("pub mod {name};")).expect("a folder of modules has a module's name");
            self.child(parent, &item, false, folder, sources);
        }
    }

    fn child(&mut self, parent: usize, item: &syn::ItemMod, test: bool, folder: &str, sources: &Sources) {
        let name = plain(&item.ident);
        let inside = join(folder, &name);
        let index = self.modules.len();
        let mut module = Module { test, parent: Some(parent), ..Module::default() };
        if let Some((_, items)) = &item.content {
            module.file.clone_from(&self.modules[parent].file);
            self.add(parent, name, module);
            self.read(index, items, &inside, sources);
            return;
        }
        let here = self.modules[parent].file.rsplit_once('/').map_or("", |(folder, _)| folder);
        let candidates = match path_attribute(&item.attrs) {
            Some(path) => vec![join(here, &path)],
            None => vec![format!("{inside}.rs"), format!("{inside}/mod.rs")],
        };
        let Some(file) = candidates.into_iter().find(|path| sources.contains_key(path)) else { return };
        let folder = match file.rsplit_once('/') {
            Some((folder, "mod.rs")) => folder.to_owned(),
            _ => file.trim_end_matches(".rs").to_owned(),
        };
        module.file.clone_from(&file);
        self.add(parent, name, module);
        self.read(index, &sources[&file].items, &folder, sources);
    }

    fn add(&mut self, parent: usize, name: String, module: Module) {
        let index = self.modules.len();
        self.modules[parent].children.insert(name, index);
        self.modules.push(module);
    }

    /// Where a path in module `at` leads, if it stays inside this crate.
    pub(crate) fn resolve(&self, at: usize, path: &[String]) -> Option<Place> {
        self.follow(at, path, MOST_STEPS)
    }

    fn follow(&self, at: usize, path: &[String], steps: usize) -> Option<Place> {
        let (first, mut rest) = path.split_first()?;
        let mut place = match first.as_str() {
            "crate" => Place::Module(0),
            "self" => Place::Module(at),
            "super" => Place::Module(self.modules[at].parent?),
            name => self.look_up(at, name, rest.is_empty(), steps)?,
        };
        while let (Place::Module(module), Some((name, after))) = (place, rest.split_first()) {
            place = match name.as_str() {
                "super" => Place::Module(self.modules[module].parent?),
                // What a macro makes is not seen as an item: it is where its module is.
                name => self.look_up(module, name, after.is_empty(), steps).unwrap_or(Place::Item(module)),
            };
            rest = after;
        }
        Some(place)
    }

    /// A name in a module. The last name of a path is an item before it is a module, the others the other way round.
    fn look_up(&self, at: usize, name: &str, last: bool, steps: usize) -> Option<Place> {
        let steps = steps.checked_sub(1)?;
        let module = &self.modules[at];
        let child = module.children.get(name).map(|&index| Place::Module(index));
        if child.is_some() && !last {
            return child;
        }
        if module.items.contains(name) {
            return Some(Place::Item(at));
        }
        let named = module.uses.iter().filter(|used| !used.glob && used.name == name);
        let mut imported = named.filter(|used| used.path.len() > 1 || used.path[0] != name);
        if let Some(place) = imported.find_map(|used| self.follow(at, &used.path, steps)) {
            return Some(place);
        }
        if child.is_some() {
            return child;
        }
        let mut globs = module.uses.iter().filter(|used| used.glob);
        globs.find_map(|used| match self.follow(at, &used.path, steps)? {
            Place::Module(other) if other != at => self.look_up(other, name, last, steps),
            _ => None,
        })
    }
}

/// Joins a relative path to a folder, `..` included.
pub(crate) fn join(folder: &str, path: &str) -> String {
    let mut parts: Vec<&str> = folder.split('/').filter(|part| !part.is_empty()).collect();
    for part in path.split('/') {
        match part {
            "" | "." => {}
            ".." => {
                parts.pop();
            }
            part => parts.push(part),
        }
    }
    parts.join("/")
}

fn path_attribute(attributes: &[syn::Attribute]) -> Option<String> {
    let attribute = attributes.iter().find(|attribute| attribute.path().is_ident("path"))?;
    let syn::Meta::NameValue(value) = &attribute.meta else { return None };
    let syn::Expr::Lit(literal) = &value.value else { return None };
    let syn::Lit::Str(text) = &literal.lit else { return None };
    Some(text.value())
}
