//! Figures as people read them: counts, bytes, durations, dates. Pure functions.

pub use report::format::{NOTHING, count, counted, number};

use proto::task::Described;
use std::collections::BTreeMap;
use std::time::Duration;

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

/// A metric's mean: a percentage of a share, else three decimals and its unit; a dash for none.
pub fn metric(metric: &Described, value: Option<f64>) -> String {
    match (value, metric.unit.as_str()) {
        (value, _) if metric.is_share() => percent(value),
        (Some(value), unit) if !unit.is_empty() => format!("{value:.3} {unit}"),
        (value, _) => number(value, 3),
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

/// Seconds since 1970 as `YYYYMMDD-HHMMSS` (UTC): sorts by time and is a valid file name everywhere.
pub fn timestamp(unix_s: u64) -> String {
    let (year, month, day) = civil_from_days((unix_s / 86400) as i64);
    let second = unix_s % 86400;
    format!("{year:04}{month:02}{day:02}-{:02}{:02}{:02}", second / 3600, second / 60 % 60, second % 60)
}

/// Seconds since 1970 as `YYYY-MM-DD HH:MM:SS UTC`.
pub fn date(unix_s: u64) -> String {
    let (year, month, day) = civil_from_days((unix_s / 86400) as i64);
    let second = unix_s % 86400;
    format!("{year:04}-{month:02}-{day:02} {:02}:{:02}:{:02} UTC", second / 3600, second / 60 % 60, second % 60)
}

/// Proleptic Gregorian date of a day number counted from 1970-01-01 (Howard Hinnant, "chrono-compatible low-level
/// date algorithms").
fn civil_from_days(days: i64) -> (i64, u32, u32) {
    let shifted = days + 719_468;
    let era = shifted.div_euclid(146_097);
    let day_of_era = shifted.rem_euclid(146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted_month = (5 * day_of_year + 2) / 153;
    let day = (day_of_year - (153 * shifted_month + 2) / 5 + 1) as u32;
    let month = if shifted_month < 10 { shifted_month + 3 } else { shifted_month - 9 } as u32;
    (year_of_era + era * 400 + i64::from(month <= 2), month, day)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_round_to_whole_seconds_before_they_are_split() {
        assert_eq!(duration(Duration::from_millis(59_400)), "59 s");
        assert_eq!(duration(Duration::from_millis(59_600)), "1 min 00 s");
        assert_eq!(duration(Duration::from_mins(125)), "2 h 05 min");
        assert_eq!(duration(Duration::from_hours(76)), "3 d 4 h");
    }

    #[test]
    fn dates_agree_with_the_calendar() {
        // Reference values: date -u -d @N +%Y%m%d-%H%M%S
        assert_eq!(timestamp(0), "19700101-000000");
        assert_eq!(timestamp(951_782_400), "20000229-000000");
        assert_eq!(timestamp(1_709_251_199), "20240229-235959");
        assert_eq!(timestamp(1_795_226_663), "20261121-020423");
        assert_eq!(date(4_102_444_800), "2100-01-01 00:00:00 UTC");
    }
}
