//! The paths in a piece of code: imports, and what is named in expressions, types and the arguments of macros.

use crate::syntax::{for_tests, plain};
use proc_macro2::{TokenStream, TokenTree};
use syn::visit::Visit;

/// One name of a `use`.
#[derive(Debug)]
pub(crate) struct Use {
    /// The path as written.
    pub path: Vec<String>,
    /// The name it gets here; empty for a glob.
    pub name: String,
    /// Whether it ends in `*`.
    pub glob: bool,
    /// Whether others get the name from here.
    pub passed_on: bool,
    /// Whether only tests have it.
    pub test: bool,
    pub line: usize,
}

#[derive(Debug)]
pub(crate) struct Mention {
    /// The path as written, without generic arguments.
    pub path: Vec<String>,
    /// Whether only tests name it.
    pub test: bool,
    pub line: usize,
}

/// Collects the paths of one item.
pub(crate) struct Reader {
    /// Imports, also those inside functions.
    pub uses: Vec<Use>,
    /// All other paths.
    pub mentions: Vec<Mention>,
    test: bool,
}

impl Reader {
    /// A reader of an item that is, or is not, for tests only.
    pub(crate) fn new(test: bool) -> Self {
        Self { uses: vec![], mentions: vec![], test }
    }

    pub(crate) fn read(&mut self, item: &syn::Item) {
        self.visit_item(item);
    }

    fn import(&mut self, tree: &syn::UseTree, before: &[String], vis: &syn::Visibility) {
        let line = |ident: &syn::Ident| ident.span().start().line;
        let mut path = before.to_vec();
        let (name, glob, line) = match tree {
            syn::UseTree::Path(inner) => {
                path.push(plain(&inner.ident));
                return self.import(&inner.tree, &path, vis);
            }
            syn::UseTree::Group(group) => {
                return group.items.iter().for_each(|inner| self.import(inner, &path, vis));
            }
            syn::UseTree::Name(last) if last.ident == "self" => {
                (path.last().cloned().unwrap_or_default(), false, line(&last.ident))
            }
            syn::UseTree::Name(last) => {
                path.push(plain(&last.ident));
                (plain(&last.ident), false, line(&last.ident))
            }
            syn::UseTree::Rename(last) => {
                if last.ident != "self" {
                    path.push(plain(&last.ident));
                }
                (plain(&last.rename), false, line(&last.ident))
            }
            syn::UseTree::Glob(glob) => (String::new(), true, glob.star_token.spans[0].start().line),
        };
        if !path.is_empty() {
            let passed_on = !matches!(vis, syn::Visibility::Inherited);
            self.uses.push(Use { path, name, glob, passed_on, test: self.test, line });
        }
    }

    /// Paths among tokens that are no syntax yet: the arguments of a macro.
    fn tokens(&mut self, tokens: TokenStream) {
        let mut tokens = tokens.into_iter().peekable();
        let mut after_dot = false;
        while let Some(token) = tokens.next() {
            let dot = matches!(&token, TokenTree::Punct(punct) if punct.as_char() == '.');
            match token {
                TokenTree::Group(group) => self.tokens(group.stream()),
                TokenTree::Ident(ident) if !after_dot => {
                    let line = ident.span().start().line;
                    let mut path = vec![plain(&ident)];
                    while matches!(tokens.peek(), Some(TokenTree::Punct(punct)) if punct.as_char() == ':') {
                        let mut ahead = tokens.clone();
                        ahead.next();
                        let second = matches!(ahead.next(), Some(TokenTree::Punct(punct)) if punct.as_char() == ':');
                        let Some(TokenTree::Ident(next)) = ahead.next().filter(|_| second) else { break };
                        path.push(plain(&next));
                        tokens = ahead;
                    }
                    self.mentions.push(Mention { path, test: self.test, line });
                }
                _ => {}
            }
            after_dot = dot;
        }
    }

    fn within(&mut self, attributes: &[syn::Attribute], visit: impl FnOnce(&mut Self)) {
        let before = self.test;
        self.test |= for_tests(attributes);
        visit(self);
        self.test = before;
    }
}

impl<'a> Visit<'a> for Reader {
    fn visit_path(&mut self, path: &'a syn::Path) {
        let line = path.segments.first().map_or(0, |first| first.ident.span().start().line);
        let names = path.segments.iter().map(|segment| plain(&segment.ident)).collect();
        if path.leading_colon.is_none() {
            self.mentions.push(Mention { path: names, test: self.test, line });
        }
        syn::visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, called: &'a syn::Macro) {
        self.visit_path(&called.path);
        self.tokens(called.tokens.clone());
    }

    fn visit_item_use(&mut self, item: &'a syn::ItemUse) {
        self.within(&item.attrs, |reader| reader.import(&item.tree, &[], &item.vis));
    }

    fn visit_item_fn(&mut self, item: &'a syn::ItemFn) {
        self.within(&item.attrs, |reader| syn::visit::visit_item_fn(reader, item));
    }

    fn visit_impl_item_fn(&mut self, item: &'a syn::ImplItemFn) {
        self.within(&item.attrs, |reader| syn::visit::visit_impl_item_fn(reader, item));
    }

    // Attributes and visibilities name no user of a module.
    fn visit_attribute(&mut self, _: &'a syn::Attribute) {}

    fn visit_visibility(&mut self, _: &'a syn::Visibility) {}

    // A module is read by its own.
    fn visit_item_mod(&mut self, _: &'a syn::ItemMod) {}
}
