pub use report::format::{NOTHING, count, counted, number, reward};

use proto::task::Described;
use recording::Recordings;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;
use time::OffsetDateTime;

/// Bytes in binary units with three significant figures: `512 B`, `1.50 GiB`.
pub fn bytes(value: u64) -> String {
    const UNITS: [&str; 5] = ["B", "KiB", "MiB", "GiB", "TiB"];
    let mut size = value as f64;
    let mut unit = 0;
    while size >= 1023.5 && unit + 1 < UNITS.len() {
        size /= 1024.0;
        unit += 1;
    }
    match (unit, size) {
        (0, _) => format!("{value} B"),
        (_, size) if size < 9.995 => format!("{size:.2} {}", UNITS[unit]),
        (_, size) if size < 99.95 => format!("{size:.1} {}", UNITS[unit]),
        (_, size) => format!("{size:.0} {}", UNITS[unit]),
    }
}

pub fn recordings(recordings: &Recordings) -> String {
    let Recordings { files, bytes: size, newest, being_written } = recordings;
    let (files, size, newest) = (counted(*files as u64, "file"), bytes(*size), newest.display());
    if *being_written {
        format!("recordings: {files}, {size}; {newest} is being written, and readable as it is up to the last second")
    } else {
        format!("recordings: {files}, {size}; the newest is {newest}")
    }
}

/// A path as it is typed: relative where it is below the current folder.
pub fn typed(path: &Path) -> PathBuf {
    let below = std::env::current_dir().ok().and_then(|here| path.strip_prefix(here).ok().map(Path::to_path_buf));
    below.filter(|below| !below.as_os_str().is_empty()).unwrap_or_else(|| path.to_path_buf())
}

/// A duration as its two leading parts: `41 s`, `3 min 20 s`, `2 h 05 min`, `3 d 4 h`.
pub fn duration(value: Duration) -> String {
    let seconds = (value.as_secs_f64() + 0.5) as u64;
    match seconds {
        0..60 => format!("{seconds} s"),
        60..3600 => format!("{} min {:02} s", seconds / 60, seconds % 60),
        3600..86400 => format!("{} h {:02} min", seconds / 3600, seconds / 60 % 60),
        _ => format!("{} d {} h", seconds / 86400, seconds / 3600 % 24),
    }
}

pub fn rate(per_second: f64) -> String {
    if per_second < 99.95 { format!("{per_second:.1}") } else { count((per_second + 0.5) as u64) }
}

pub fn percent(share: Option<f64>) -> String {
    share.map_or_else(|| NOTHING.to_owned(), |share| format!("{:.1}%", 100.0 * share))
}

pub fn metric(metric: &Described, value: Option<f64>) -> String {
    let unit = if metric.is_share() || value.is_none() { "" } else { metric.unit.as_str() };
    format!("{} {unit}", shown(metric, value)).trim_end().to_owned()
}

/// A figure without its unit. The page has the same digits.
pub fn shown(one: &Described, figure: Option<f64>) -> String {
    match one.unit.as_str() {
        _ if one.is_share() => percent(figure),
        "m" => number(figure, 3),
        "steps" => number(figure, 1),
        _ => number(figure, 2),
    }
}

pub fn metrics<'a>(
    metrics: impl IntoIterator<Item = &'a Described>,
    figures: &BTreeMap<String, f64>,
    between: &str,
) -> String {
    let each = metrics.into_iter().map(|one| format!("{} {}", one.label, metric(one, one.mean(figures))));
    each.collect::<Vec<_>>().join(between)
}

/// A time that no calendar has is the first of all.
fn moment(unix_s: u64) -> OffsetDateTime {
    let moment = i64::try_from(unix_s).map(OffsetDateTime::from_unix_timestamp);
    moment.ok().and_then(Result::ok).unwrap_or(OffsetDateTime::UNIX_EPOCH)
}

/// Seconds since 1970 as `YYYYMMDD-HHMMSS` (UTC): sorts by time and is a valid file name everywhere.
pub fn timestamp(unix_s: u64) -> String {
    let at = moment(unix_s);
    let day = day(unix_s).replace('-', "");
    format!("{day}-{:02}{:02}{:02}", at.hour(), at.minute(), at.second())
}

/// As `YYYY-MM-DD` (UTC).
pub fn day(unix_s: u64) -> String {
    moment(unix_s).date().to_string()
}

/// As `ls` has it (UTC): `Nov 30 19:14`, half a year away from now `Nov 30  2025`.
pub fn begun(unix_s: u64, now_s: u64) -> String {
    let at = moment(unix_s);
    let month = &at.month().to_string()[..3];
    let is_near = now_s.abs_diff(unix_s) < 182 * 86_400;
    let time = if is_near { format!("{:02}:{:02}", at.hour(), at.minute()) } else { format!("{:>5}", at.year()) };
    format!("{month} {:>2} {time}", at.day())
}

pub fn date(unix_s: u64) -> String {
    let at = moment(unix_s);
    format!("{} {:02}:{:02}:{:02} UTC", day(unix_s), at.hour(), at.minute(), at.second())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::task::Kind;

    #[test]
    fn a_path_below_the_current_folder_is_relative() {
        let here = std::env::current_dir().unwrap();
        assert_eq!(typed(&here.join("runs/first")), Path::new("runs/first"));
        for other in [&here, Path::new("/elsewhere/first"), Path::new("runs/first")] {
            assert_eq!(typed(other), other);
        }
    }

    #[test]
    fn durations_round_to_whole_seconds_before_they_are_split() {
        assert_eq!(duration(Duration::from_millis(59_400)), "59 s");
        assert_eq!(duration(Duration::from_millis(59_600)), "1 min 00 s");
        assert_eq!(duration(Duration::from_mins(125)), "2 h 05 min");
        assert_eq!(duration(Duration::from_hours(76)), "3 d 4 h");
    }

    #[test]
    fn a_figure_has_its_unit_and_the_digits_of_it() {
        let one = |unit: &str, kind| Described {
            name: String::new(),
            label: String::new(),
            unit: unit.to_owned(),
            kind,
            doc: String::new(),
            quotient: None,
        };
        assert_eq!(metric(&one("", Kind::Share), Some(0.5)), "50.0%");
        assert_eq!(metric(&one("m", Kind::F32), Some(0.0584)), "0.058 m");
        assert_eq!(metric(&one("steps", Kind::Count), Some(12.34)), "12.3 steps");
        assert_eq!(metric(&one("", Kind::F64), Some(500.0)), "500.00");
        assert_eq!(metric(&one("m", Kind::F32), None), NOTHING);
    }

    #[test]
    fn dates_agree_with_the_calendar() {
        // Reference values: date -u -d @N +%Y%m%d-%H%M%S
        assert_eq!(timestamp(0), "19700101-000000");
        assert_eq!(timestamp(951_782_400), "20000229-000000");
        assert_eq!(timestamp(1_709_251_199), "20240229-235959");
        assert_eq!(timestamp(1_795_226_663), "20261121-020423");
        assert_eq!(date(4_102_444_800), "2100-01-01 00:00:00 UTC");
        assert_eq!(begun(1_795_226_663, 1_795_300_000), "Nov 21 02:04");
        assert_eq!(begun(1_709_251_199, 1_795_226_663), "Feb 29  2024");
    }
}
