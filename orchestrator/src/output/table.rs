use crate::output::format::NOTHING;

const BETWEEN: usize = 2;
/// So wide a column stays as long as the first can be narrower.
const COMFORTABLE: usize = 12;
const NARROWEST: usize = 8;

pub fn aligned(rows: &[Vec<String>]) -> Vec<String> {
    lines(rows, &widths(rows))
}

fn widths(rows: &[Vec<String>]) -> Vec<usize> {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = |column: usize| {
        let of = |row: &Vec<String>| row.get(column).map_or(0, |cell| cell.chars().count());
        rows.iter().map(of).max().unwrap_or(0)
    };
    (0..columns).map(width).collect()
}

fn lines(rows: &[Vec<String>], widths: &[usize]) -> Vec<String> {
    let line = |row: &Vec<String>| {
        // Not by the formatter, which panics from 65,536 letters on.
        let padded = |(cell, &width): (&String, &usize)| cell.clone() + &" ".repeat(width - cell.chars().count());
        let cells = row.iter().zip(widths).map(padded);
        cells.collect::<Vec<_>>().join(&" ".repeat(BETWEEN)).trim_end().to_owned()
    };
    rows.iter().map(line).collect()
}

/// The same in so many columns of a terminal, if it is one: cells that are too wide go on below themselves; those that a
/// line begins with only if they take more than half of it.
pub fn fitted(rows: &[Vec<String>], terminal: Option<usize>) -> Vec<String> {
    let Some(most) = terminal else { return aligned(rows) };
    let mut widths = widths(rows);
    while widths.iter().sum::<usize>() + BETWEEN * widths.len().saturating_sub(1) > most {
        let (first, others) = widths.split_at_mut(1);
        match others.iter_mut().max() {
            Some(widest) if *widest > COMFORTABLE => *widest -= 1,
            _ if first[0] > (most / 2).max(NARROWEST) => first[0] -= 1,
            Some(widest) if *widest > NARROWEST => *widest -= 1,
            _ => break,
        }
    }
    let broken = |row: &Vec<String>| {
        let cells: Vec<_> = row.iter().zip(&widths).map(|(cell, &width)| wrapped(cell, width)).collect();
        let height = cells.iter().map(Vec::len).max().unwrap_or(0);
        let line = |at: usize| cells.iter().map(|cell| cell.get(at).cloned().unwrap_or_default()).collect();
        (0..height).map(line).collect::<Vec<Vec<String>>>()
    };
    lines(&rows.iter().flat_map(broken).collect::<Vec<_>>(), &widths)
}

/// A text in lines of at most `width` characters, broken between words, and within a word that is longer alone.
pub fn wrapped(text: &str, width: usize) -> Vec<String> {
    let mut lines = Vec::new();
    let (width, mut rest): (usize, Vec<char>) = (width.max(1), text.chars().collect());
    while rest.len() > width {
        let fits = &rest[..=width];
        let indent = rest.iter().take_while(|letter| **letter == ' ').count();
        let space = fits.iter().rposition(|letter| *letter == ' ').filter(|at| *at > indent);
        let within = || fits[..width].iter().rposition(|letter| "/-_,.".contains(*letter)).map_or(width, |at| at + 1);
        let end = space.unwrap_or_else(within);
        let line: String = rest.drain(..end).collect();
        lines.push(line.trim_end().to_owned());
        let spaces = rest.iter().take_while(|letter| **letter == ' ').count();
        rest.drain(..spaces);
    }
    if !rest.is_empty() || lines.is_empty() {
        lines.push(rest.into_iter().collect());
    }
    lines
}

/// A text of at most `most` characters: what is longer ends with an ellipsis. Without text a dash.
pub fn cell(text: &str, most: usize) -> String {
    match text.chars().count() {
        0 => NOTHING.to_owned(),
        length if length <= most => text.to_owned(),
        _ => text.chars().take(most.saturating_sub(1)).chain(['…']).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_fits_the_terminal_and_breaks_between_words() {
        let row = |cells: [&str; 3]| cells.map(str::to_owned).to_vec();
        let rows = [row(["runs/a", "both stages in minutes", "7"]), row(["runs/bc", "gym", "12"])];
        let plain = ["runs/a   both stages in minutes  7", "runs/bc  gym                     12"];
        assert_eq!(aligned(&rows), plain);
        assert_eq!([fitted(&rows, None), fitted(&rows, Some(35))], [plain, plain]);
        let expected = ["runs/a   both stages  7", "         in minutes", "runs/bc  gym          12"];
        assert_eq!(fitted(&rows, Some(24)), expected);
        let long = [row(["runs/a/evaluations/20261121-test", "complete", "gym, seed 1"])];
        let expected = ["runs/a/evaluations/   complete  gym,", "20261121-test                   seed 1"];
        assert_eq!(fitted(&long, Some(40)), expected);
        assert!(fitted(&rows, Some(1)).iter().all(|line| line.len() < 22), "as narrow as it can be");
        assert_eq!(wrapped("  one two", 6), ["  one", "two"]);
        assert_eq!(wrapped("runs/20261121-demo", 10), ["runs/", "20261121-", "demo"]);
        assert_eq!([wrapped("", 5), wrapped("abcdefg", 5)], [vec![""], vec!["abcde", "fg"]]);
    }
}
