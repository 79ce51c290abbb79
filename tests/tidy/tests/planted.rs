//! Each rule finds what is planted, and leaves a clean tree alone.

use tidy::{Finding, Rule, Tree, findings};

/// A library and a program that keep to all rules.
fn clean() -> Tree {
    let mut tree = Tree::default();
    tree.add("Cargo.toml", "[workspace]\nmembers = [\"stock\", \"shop\"]\n");
    tree.add("stock/Cargo.toml", "[package]\nname = \"stock\"\n");
    tree.add("stock/src/lib.rs", "//! Stock.\npub mod price;\nmod shelf;\npub use shelf::Shelf;\n");
    tree.add("stock/src/price.rs", "//! Prices.\nuse crate::Shelf;\npub fn price(shelf: &Shelf) -> u32 { shelf.0 }\n");
    tree.add("stock/src/shelf/mod.rs", "//! Shelves, in `shelf/board.rs`.\nmod board;\npub use board::Shelf;\n");
    tree.add("stock/src/shelf/board.rs", BOARD);
    tree.add("shop/Cargo.toml", "[package]\nname = \"shop\"\n");
    tree.add("shop/src/main.rs", "//! Shop.\nmod till;\nfn main() { till::count(); }\n");
    tree.add("shop/src/till.rs", "//! Till.\npub fn count() { stock::price::price(&stock::Shelf::new(3)); }\n");
    tree
}

const BOARD: &str = "//! Boards.
pub struct Shelf(pub u32);
impl Shelf {
    pub fn new(length: u32) -> Self { Self(length) }
}
#[cfg(test)]
mod tests {
    use crate::price::price;
    fn holds(length: u32) { assert_eq!(price(&super::Shelf::new(length)), length); }
    #[test]
    fn a_shelf_has_a_price() { holds(2); }
}
";

/// What is found where `path` holds `text` instead.
fn planted(path: &str, text: &str) -> Vec<Finding> {
    let mut tree = clean();
    tree.add(path, text);
    findings(&tree)
}

#[test]
fn a_clean_tree_has_no_findings() {
    assert_eq!(findings(&clean()), []);
}

#[test]
fn a_circle_is_found_by_use_and_by_path() {
    let price = "pub fn price(shelf: &crate::Shelf) -> u32 { shelf.0 }\n";
    for (uses, line) in [
        ("use crate::price::price;\nfn twice(shelf: &Shelf) -> u32 { price(shelf) }\n", 2),
        ("use super::super::price;\nfn twice(shelf: &Shelf) -> u32 { price::price(shelf) }\n", 3),
        ("fn twice(shelf: &Shelf) -> String { format!(\"{}\", crate::price::price(shelf)) }\n", 2),
        ("use crate::*;\nfn twice(shelf: &Shelf) -> u32 { price::price(shelf) }\n", 3),
    ] {
        let mut tree = clean();
        tree.add("stock/src/price.rs", price);
        tree.add("stock/src/shelf/board.rs", &BOARD.replacen("Boards.\n", &format!("Boards.\n{uses}"), 1));
        let found = findings(&tree);
        assert_eq!(found.len(), 1, "{uses}{found:#?}");
        assert_eq!((found[0].rule, found[0].path.as_str()), (Rule::Circle, "stock/src/price.rs"));
        assert_eq!(found[0].what, "circle of modules price.rs -> shelf/board.rs -> price.rs");
        let back = format!("stock/src/shelf/board.rs:{line} uses stock/src/price.rs");
        assert!(found[0].detail.contains(&back), "{uses}{}", found[0].detail);
    }
}

#[test]
fn a_file_that_declares_and_has_code_of_its_own_is_part_of_a_circle() {
    let own = "//! Shelves.\nmod board;\npub use board::Shelf;\npub fn longest() -> u32 { Shelf::new(1).0 }\n";
    let mut tree = clean();
    tree.add("stock/src/shelf/mod.rs", own);
    tree.add("stock/src/shelf/board.rs", &BOARD.replace("Self(length)", "Self(length.min(super::longest()))"));
    let found = findings(&tree);
    assert_eq!(found.iter().map(|finding| finding.rule).collect::<Vec<_>>(), [Rule::Circle], "{found:#?}");
    assert_eq!(found[0].what, "circle of modules shelf/board.rs -> shelf/mod.rs -> shelf/board.rs");
}

#[test]
fn rooms_that_use_each_other_are_found_though_no_files_do() {
    let wood = |uses: &str| {
        let mut tree = clean();
        tree.add("stock/src/lib.rs", "//! Stock.\npub mod price;\nmod shelf;\nmod wood;\npub use shelf::Shelf;\n");
        tree.add("stock/src/shelf/mod.rs", "//! Shelves.\nmod board;\npub mod nail;\npub use board::Shelf;\n");
        tree.add("stock/src/shelf/nail.rs", "//! Nails.\npub const NAIL: u32 = 1;\n");
        tree.add("stock/src/shelf/board.rs", &BOARD.replace("Self(length)", "Self(crate::wood::plank::sawn(length))"));
        tree.add("stock/src/wood/mod.rs", "//! Wood.\npub mod plank;\nmod saw;\n");
        tree.add("stock/src/wood/plank.rs", "//! Planks.\npub fn sawn(length: u32) -> u32 { length }\n");
        tree.add("stock/src/wood/saw.rs", &format!("//! Saws.\n{uses}"));
        findings(&tree)
    };
    let found = wood("use crate::shelf::nail::NAIL;\nfn bent() -> u32 { NAIL }\n");
    assert_eq!(found.len(), 1, "{found:#?}");
    assert_eq!((found[0].rule, found[0].path.as_str()), (Rule::RoomCircle, "stock/src/shelf/board.rs"));
    assert_eq!(found[0].what, "circle of rooms shelf -> wood -> shelf");
    assert!(found[0].detail.contains("stock/src/wood/saw.rs:2 uses stock/src/shelf/nail.rs"), "{}", found[0].detail);
    // The other direction alone is none, and tests may use anything.
    let only_tests = "#[cfg(test)]\nuse crate::shelf::nail::NAIL;\n";
    let rules = |uses| wood(uses).iter().map(|finding| finding.rule).collect::<Vec<_>>();
    assert_eq!(rules("fn bent() -> u32 { 1 }\n"), []);
    assert_eq!(rules(only_tests), []);
}

#[test]
fn a_source_that_does_not_parse_is_named() {
    let found = planted("shop/src/till.rs", "pub fn count( {}\n");
    assert!(found.iter().any(|finding| finding.rule == Rule::Unreadable && finding.path == "shop/src/till.rs"));
}

#[test]
fn a_file_of_a_run_folder_is_opened_in_one_way() {
    let library = |uses: &str| {
        let mut tree = Tree::default();
        tree.add("view/Cargo.toml", "[package]\nname = \"view\"\n");
        tree.add("view/src/lib.rs", &format!("//! View.\n{uses}"));
        findings(&tree)
    };
    for (call, line) in [
        ("use std::fs::read_to_string;\n", 2),
        ("fn a() -> usize { std::fs::read(\"a\").map_or(0, |read| read.len()) }\n", 2),
        ("use std::fs::File;\nfn a() -> bool { File::open(\"a\").is_ok() }\n", 3),
        ("fn a() -> String { format!(\"{:?}\", std::fs::OpenOptions::new().read(true).open(\"a\")) }\n", 2),
        ("use proto::bounded;\nfn a() -> bool { bounded::read_text(std::path::Path::new(\"a\")).is_ok() }\n", 3),
    ] {
        let found = library(call);
        assert_eq!(found.len(), 1, "{call}{found:#?}");
        assert_eq!((found[0].rule, found[0].line), (Rule::Opening, line), "{call}");
    }
    let test = "#[cfg(test)]\nmod tests {\n    fn a() -> bool { std::fs::read(\"a\").is_ok() }\n}\n";
    assert_eq!(library(test), [], "tests may open what they like");
    let other =
        "//! Till.\npub fn count() { stock::price::price(&stock::Shelf::new(3)); std::fs::read(\"a\").ok(); }\n";
    assert_eq!(planted("shop/src/till.rs", other), [], "a crate that reads no runs");
}
