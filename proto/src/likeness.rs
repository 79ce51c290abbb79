//! Names that were probably meant by one that is not there.

/// How alike two names are, 0 to 1; capitals do not matter.
pub fn likeness(a: &str, b: &str) -> f64 {
    strsim::jaro_winkler(&a.to_lowercase(), &b.to_lowercase())
}

/// The candidate closest to `word`, if any is close.
pub fn nearest<'a>(word: &str, candidates: impl Iterator<Item = &'a str>) -> Option<String> {
    candidates
        .map(|candidate| (likeness(word, candidate), candidate))
        .filter(|(score, candidate)| *score > 0.7 && few_edits(word, candidate))
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, candidate)| candidate.to_owned())
}

/// Whether half of the letters stay in place, or one name begins as the other: letters in common alone make `ppo` like
/// `recipe-procedural`.
fn few_edits(a: &str, b: &str) -> bool {
    let [a, b] = [a, b].map(str::to_lowercase);
    a.starts_with(&b) || b.starts_with(&a) || strsim::normalized_damerau_levenshtein(&a, &b) > 0.5
}

/// The end of a message about a name that is not there.
pub fn suggestion(nearest: Option<&str>) -> String {
    nearest.map_or_else(String::new, |nearest| format!(" (did you mean `{nearest}`?)"))
}

/// The same, and all names that there are, which `what` calls them.
pub fn among<'a>(word: &str, what: &str, names: impl Iterator<Item = &'a str>) -> String {
    let all: Vec<&str> = names.collect();
    format!("{}; {what}: {}", suggestion(nearest(word, all.iter().copied()).as_deref()), all.join(", "))
}

#[cfg(test)]
mod tests {
    use super::nearest;

    #[test]
    fn a_few_letters_in_common_are_not_enough() {
        let known = ["demo", "gym", "paper", "recipe-procedural", "disturb-two-stage"];
        let near = |word| nearest(word, known.into_iter());
        assert_eq!(near("ppo"), None);
        assert_eq!(near("demmo").as_deref(), Some("demo"));
        assert_eq!(near("pepper").as_deref(), Some("paper"));
        assert_eq!(near("disturb").as_deref(), Some("disturb-two-stage"));
        assert_eq!(near("recipe-procedurall").as_deref(), Some("recipe-procedural"));
    }
}
