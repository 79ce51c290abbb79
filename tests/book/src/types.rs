//! Structs and enums of sources, with their documentation.

use crate::{BookError, read};
use std::collections::BTreeMap;
use std::path::Path;
use syn::punctuated::Punctuated;

/// Types by name.
// syn's types are no `Debug` without a feature that is long to compile.
#[derive(Default)]
#[allow(missing_debug_implementations)]
pub struct Types {
    structs: BTreeMap<String, syn::ItemStruct>,
    enums: BTreeMap<String, syn::ItemEnum>,
}

#[derive(Debug)]
pub(crate) struct Field {
    pub name: String,
    /// As written, without spaces: `Option<FromConfig>`.
    pub kind: String,
    pub doc: String,
}

impl Types {
    /// The types of all sources below a folder.
    pub fn below(folder: &Path) -> Result<Self, BookError> {
        let mut types = Self::default();
        types.read_folder(folder)?;
        Ok(types)
    }

    fn read_folder(&mut self, folder: &Path) -> Result<(), BookError> {
        let unreadable = |cause| BookError::Unreadable { path: folder.to_owned(), cause };
        let entries = std::fs::read_dir(folder).map_err(unreadable)?;
        for entry in entries {
            let path = entry.map_err(unreadable)?.path();
            if path.is_dir() {
                self.read_folder(&path)?;
            } else if path.extension().is_some_and(|ending| ending == "rs") {
                self.add(&read(&path)?).map_err(|cause| BookError::NoRust { path, cause })?;
            }
        }
        Ok(())
    }

    pub fn add(&mut self, source: &str) -> Result<(), syn::Error> {
        for item in syn::parse_file(source)?.items {
            match item {
                syn::Item::Struct(item) => _ = self.structs.insert(item.ident.to_string(), item),
                syn::Item::Enum(item) => _ = self.enums.insert(item.ident.to_string(), item),
                _ => {}
            }
        }
        Ok(())
    }

    /// What a type is for.
    pub(crate) fn doc_of(&self, name: &str) -> Result<String, BookError> {
        let item = self.structs.get(name).ok_or_else(|| BookError::NoType(name.to_owned()))?;
        Ok(doc(&item.attrs))
    }

    /// Whether it is a struct with fields.
    pub(crate) fn is_struct(&self, name: &str) -> bool {
        self.structs.get(name).is_some_and(|item| matches!(item.fields, syn::Fields::Named(_)))
    }

    pub(crate) fn fields(&self, name: &str) -> Result<Vec<Field>, BookError> {
        let item = self.structs.get(name).ok_or_else(|| BookError::NoType(name.to_owned()))?;
        let named = item.fields.iter().filter_map(|field| {
            let name = field.ident.as_ref()?.to_string();
            Some(Field { name, kind: written(&field.ty), doc: doc(&field.attrs) })
        });
        Ok(named.collect())
    }

    /// The values of an enum without fields as a configuration names them, each with its documentation; none if it is
    /// no such enum.
    pub(crate) fn variants(&self, name: &str) -> Option<Vec<(String, String)>> {
        let item = self.enums.get(name)?;
        let plain = item.variants.iter().all(|variant| matches!(variant.fields, syn::Fields::Unit));
        let named = |variant: &syn::Variant| {
            renamed(&variant.attrs, "rename").unwrap_or_else(|| snake_case(&variant.ident.to_string()))
        };
        plain.then(|| item.variants.iter().map(|variant| (named(variant), doc(&variant.attrs))).collect())
    }

    /// What the values of an enum mean of which some have fields; none of another type.
    pub(crate) fn meanings(&self, name: &str) -> Vec<String> {
        let item = self.enums.get(name).filter(|_| self.variants(name).is_none());
        item.map(|item| item.variants.iter().map(|variant| doc(&variant.attrs)).collect()).unwrap_or_default()
    }
}

/// The documentation among attributes, as one line.
fn doc(attributes: &[syn::Attribute]) -> String {
    let lines = attributes.iter().filter_map(|attribute| {
        let syn::Meta::NameValue(pair) = &attribute.meta else { return None };
        let syn::Expr::Lit(literal) = &pair.value else { return None };
        match &literal.lit {
            syn::Lit::Str(text) if pair.path.is_ident("doc") => Some(text.value().trim().to_owned()),
            _ => None,
        }
    });
    lines.collect::<Vec<_>>().join(" ")
}

/// The value of `#[serde(NAME = "...")]`.
fn renamed(attributes: &[syn::Attribute], name: &str) -> Option<String> {
    let serde = attributes.iter().find(|attribute| attribute.path().is_ident("serde"))?;
    let pairs = serde.parse_args_with(Punctuated::<syn::Meta, syn::Token![,]>::parse_terminated).ok()?;
    pairs.iter().find_map(|meta| match meta {
        syn::Meta::NameValue(syn::MetaNameValue {
            path,
            value: syn::Expr::Lit(syn::ExprLit { lit: syn::Lit::Str(text), .. }),
            ..
        }) if path.is_ident(name) => Some(text.value()),
        _ => None,
    })
}

/// serde's snake case: a capital letter begins a word.
fn snake_case(name: &str) -> String {
    let mut result = String::new();
    for (at, letter) in name.char_indices() {
        if letter.is_uppercase() && at > 0 {
            result.push('_');
        }
        result.extend(letter.to_lowercase());
    }
    result
}

/// A type as it is written, without paths: `Vec<String>`.
fn written(kind: &syn::Type) -> String {
    let syn::Type::Path(path) = kind else { return String::from("?") };
    let Some(last) = path.path.segments.last() else { return String::from("?") };
    let inner = match &last.arguments {
        syn::PathArguments::AngleBracketed(arguments) => {
            let types = arguments.args.iter().filter_map(|argument| match argument {
                syn::GenericArgument::Type(kind) => Some(written(kind)),
                _ => None,
            });
            format!("<{}>", types.collect::<Vec<_>>().join(","))
        }
        _ => String::new(),
    };
    format!("{}{inner}", last.ident)
}
