use crate::output::format::NOTHING;

const BETWEEN: usize = 2;
const NARROWEST: usize = 8;

pub fn aligned(rows: &[Vec<String>]) -> Vec<String> {
    right_aligned(rows, usize::MAX)
}

/// All columns but the first `left` end below each other.
pub fn right_aligned(rows: &[Vec<String>], left: usize) -> Vec<String> {
    let widths = widths(rows);
    let align = |(column, cell): (usize, &String)| {
        // Not by the formatter, which panics from 65,536 letters on.
        let padding = " ".repeat(widths[column].saturating_sub(cell.chars().count()));
        if column < left { format!("{cell}{padding}") } else { format!("{padding}{cell}") }
    };
    let line = |row: &Vec<String>| row.iter().enumerate().map(align).collect::<Vec<_>>().join(&" ".repeat(BETWEEN));
    rows.iter().map(|row| line(row).trim_end().to_owned()).collect()
}

fn widths(rows: &[Vec<String>]) -> Vec<usize> {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    // A cell after which the row ends, such as a title, moves no column.
    let counts = |row: &&Vec<String>, column: usize| row.len() > column + 1 || row.len() == columns;
    let width = |column: usize| {
        let of = |row: &Vec<String>| row.get(column).map_or(0, |cell| cell.chars().count());
        rows.iter().filter(|row| counts(row, column)).map(of).max().unwrap_or(0)
    };
    (0..columns).map(width).collect()
}

/// A text behind a head; where it is wider than so many columns, it goes on below itself.
pub fn beside(head: &str, text: &str, terminal: Option<usize>) -> Vec<String> {
    let indent = head.chars().count();
    let width = terminal.map_or(usize::MAX, |most| most.saturating_sub(indent).max(NARROWEST));
    let below = " ".repeat(indent);
    let heads = std::iter::once(head).chain(std::iter::repeat(below.as_str()));
    heads.zip(wrapped(text, width)).map(|(head, line)| format!("{head}{line}")).collect()
}

/// A table with the first cell, a path, in a line of its own where the table is wider than so many columns; without
/// columns where the others are too wide as well.
pub fn below_paths(rows: &[Vec<String>], terminal: Option<usize>) -> Vec<String> {
    let lines = aligned(rows);
    let Some(most) = terminal.filter(|&most| is_wider(&lines, most)) else { return lines };
    let most = most.saturating_sub(BETWEEN);
    let others: Vec<Vec<String>> = rows.iter().map(|row| row.iter().skip(1).cloned().collect()).collect();
    let joined = |row: &Vec<String>| row.iter().filter(|cell| !cell.is_empty()).cloned().collect::<Vec<_>>().join("  ");
    let in_columns = aligned(&others);
    let others = if is_wider(&in_columns, most) { others.iter().map(joined).collect() } else { in_columns };
    let mut lines = Vec::new();
    for (row, line) in rows.iter().zip(others) {
        lines.extend(row.first().cloned());
        lines.extend(wrapped(&line, most).into_iter().map(|line| " ".repeat(BETWEEN) + &line));
    }
    lines
}

/// As many of the parts, the first ones, as fit a line of so many columns.
pub fn fitting(parts: impl IntoIterator<Item = String>, columns: usize) -> String {
    let mut line = String::new();
    for part in parts.into_iter().filter(|part| !part.is_empty()) {
        let before = if line.is_empty() { "" } else { " | " };
        if [line.as_str(), before, &part].iter().map(|text| text.chars().count()).sum::<usize>() > columns {
            break;
        }
        line.push_str(before);
        line.push_str(&part);
    }
    line
}

pub fn is_wider(lines: &[String], most: usize) -> bool {
    lines.iter().any(|line| line.chars().count() > most)
}

/// Tables of as many columns as fit beside the first one, which each has.
pub fn blocks(rows: &[Vec<String>], terminal: Option<usize>) -> Vec<Vec<Vec<String>>> {
    let (widths, most) = (widths(rows), terminal.unwrap_or(usize::MAX));
    let (mut blocks, mut begin) = (Vec::new(), 1);
    while begin < widths.len() {
        let mut width = widths[0];
        let fits = |next: &&usize| {
            width += BETWEEN + **next;
            width <= most
        };
        let count = widths[begin..].iter().take_while(fits).count().max(1);
        let part = |row: &Vec<String>| row.iter().take(1).chain(row.iter().skip(begin).take(count)).cloned().collect();
        blocks.push(rows.iter().map(part).collect());
        begin += count;
    }
    blocks
}

/// A text in lines of at most `width` characters, broken where two spaces stand, as between figures, else between words, and
/// within a word that is longer alone; in a path only behind a slash, so that one with a longer name is wider.
pub fn wrapped(text: &str, width: usize) -> Vec<String> {
    let mut lines = Vec::new();
    let (width, mut rest): (usize, Vec<char>) = (width.max(1), text.chars().collect());
    while rest.len() > width {
        let fits = &rest[..=width];
        let indent = rest.iter().take_while(|letter| **letter == ' ').count();
        let space = fits.iter().rposition(|letter| *letter == ' ').filter(|at| *at > indent);
        let gap = rest[..rest.len().min(width + 2)].windows(2).rposition(|pair| pair == [' ', ' ']);
        let end = gap.filter(|at| *at > indent).or(space).unwrap_or_else(|| end_within(&rest, indent, width));
        let line: String = rest.drain(..end).collect();
        // A bar between two figures stands between none where the line ends.
        let line = line.trim_end();
        lines.push(line.strip_suffix("  |").unwrap_or(line).to_owned());
        let is_bar = |at: usize| rest[at..].starts_with(&['|', ' ', ' ']);
        let gap = (0..rest.len()).take_while(|&at| rest[at] == ' ' || is_bar(at)).count();
        rest.drain(..gap);
    }
    if !rest.is_empty() || lines.is_empty() {
        lines.push(rest.into_iter().collect());
    }
    lines
}

/// Where a line ends within its first word, which is wider.
fn end_within(text: &[char], indent: usize, width: usize) -> usize {
    let word = text[indent..].iter().position(|letter| *letter == ' ').map_or(text.len(), |at| indent + at);
    if !text[..word].contains(&'/') {
        return text[..width].iter().rposition(|letter| "-_,.".contains(*letter)).map_or(width, |at| at + 1);
    }
    let mut slashes = (indent + 1..word).filter(|at| text[*at] == '/').map(|at| at + 1);
    let first = slashes.next().unwrap_or(word);
    slashes.take_while(|end| *end <= width).last().unwrap_or(first)
}

/// A text of at most `most` characters in one line: what is longer ends with an ellipsis, and of a path the end is kept,
/// which tells it from others. Without text a dash.
pub fn cell(text: &str, most: usize) -> String {
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    match text.chars().count() {
        0 => NOTHING.to_owned(),
        length if length <= most => text,
        length if text.contains('/') && !text.contains(' ') => {
            let kept: String = text.chars().skip(length - most.saturating_sub(1)).collect();
            format!("…{}", &kept[kept.find('/').unwrap_or(0)..])
        }
        _ => text.chars().take(most.saturating_sub(1)).chain(['…']).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_a_path_that_is_cut_the_end_is_kept() {
        let path = "/tmp/a/checkpoints/rollout-00000363.json";
        assert_eq!(cell(path, 34), "…/rollout-00000363.json");
        assert_eq!(cell(path, 16), "…t-00000363.json");
        assert_eq!([cell("a/b", 3), cell("one / two", 5)], ["a/b", "one …"]);
    }

    #[test]
    fn a_table_fits_the_terminal_and_breaks_between_words() {
        let row = |cells: [&str; 3]| cells.map(str::to_owned).to_vec();
        let rows = [row(["runs/a", "both stages in minutes", "7"]), row(["runs/bc", "gym", "12"])];
        let plain = ["runs/a   both stages in minutes  7", "runs/bc  gym                     12"];
        assert_eq!(aligned(&rows), plain);
        let text = "both stages in minutes";
        assert_eq!(beside("demo  ", text, None), ["demo  both stages in minutes"]);
        assert_eq!(beside("demo  ", text, Some(18)), ["demo  both stages", "      in minutes"]);
        assert_eq!(beside("demo  ", text, Some(1))[0], "demo  both", "as narrow as it can be");
        assert_eq!(below_paths(&rows, Some(35)), plain);
        let below = ["runs/a", "  both stages in minutes  7", "runs/bc", "  gym                     12"];
        assert_eq!(below_paths(&rows, Some(28)), below);
        let no_columns = ["runs/a", "  both stages in minutes  7", "runs/bc", "  gym  12"];
        assert_eq!(below_paths(&rows, Some(27)), no_columns);
        let figures = "SR 5.0%  worst severity 0.1 m  exposure 1 step";
        assert_eq!(wrapped(figures, 29), ["SR 5.0%  worst severity 0.1 m", "exposure 1 step"]);
        assert_eq!(wrapped(figures, 28), ["SR 5.0%", "worst severity 0.1 m", "exposure 1 step"]);
        assert_eq!(wrapped(figures, 15)[..3], ["SR 5.0%", "worst severity", "0.1 m"]);
        let barred =
            [12, 13, 14, 15, 16].map(|width| wrapped("9 / 9 frames  |  7 frames/s  |  1 s left", width).join("/"));
        assert!(barred.iter().all(|lines| lines == "9 / 9 frames/7 frames/s/1 s left"), "{barred:?}");
        let titled = [vec!["a title of a part".to_owned()], row(["a", "b", "c"])];
        assert_eq!(aligned(&titled), ["a title of a part", "a  b  c"]);
        assert_eq!(wrapped("  one two", 6), ["  one", "two"]);
        assert_eq!(wrapped("runs/20261121-demo", 10), ["runs/", "20261121-", "demo"]);
        assert_eq!(wrapped("in /one-long/a/b-c, d-e", 9), ["in", "/one-long/", "a/b-c,", "d-e"]);
        assert_eq!(wrapped("a-word-without/ end", 9), ["a-word-without/", "end"]);
        assert_eq!(wrapped("20261121-demo", 10), ["20261121-", "demo"]);
        assert_eq!([wrapped("", 5), wrapped("abcdefg", 5)], [vec![""], vec!["abcde", "fg"]]);
    }
}
