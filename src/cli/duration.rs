//! Durations on the command line: a whole number and its unit.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use serde::{Serialize, Serializer};

/// The longest that is taken: what is longer is a slip, and no clock can be asked for the end of
/// all of them.
const LONGEST_HOURS: u64 = 365 * 24;

/// How often or how long, in whole seconds; written as it is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Period(pub(super) Duration);

impl FromStr for Period {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        duration(text).map(Self)
    }
}

impl fmt::Display for Period {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0.as_secs() {
            seconds if seconds > 0 && seconds % 3_600 == 0 => {
                write!(formatter, "{}h", seconds / 3_600)
            }
            seconds if seconds > 0 && seconds % 60 == 0 => write!(formatter, "{}m", seconds / 60),
            seconds => write!(formatter, "{seconds}s"),
        }
    }
}

impl Serialize for Period {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// Reads a time: 20s, 5m or 1h, up to a year.
pub(super) fn duration(text: &str) -> Result<Duration, String> {
    let wrong = || {
        format!(
            "got {text:?}, expected a whole number and s, m or h such as 20s, at most {LONGEST_HOURS}h"
        )
    };

    let (number, unit) =
        text.split_at(text.len() - text.chars().next_back().map_or(0, char::len_utf8));
    let seconds = match unit {
        "s" => 1,
        "m" => 60,
        "h" => 3_600,
        _ => return Err(wrong()),
    };

    let number: u64 = number.parse().map_err(|_| wrong())?;
    let seconds = number
        .checked_mul(seconds)
        .filter(|seconds| *seconds <= LONGEST_HOURS * 3_600);
    seconds.map(Duration::from_secs).ok_or_else(wrong)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_have_a_unit() {
        assert_eq!(duration("20s"), Ok(Duration::from_secs(20)));
        assert_eq!(duration("2m"), Ok(Duration::from_secs(120)));
        assert_eq!(duration("0s"), Ok(Duration::ZERO));
        for bad in [
            "",
            "20",
            "s",
            "-1s",
            "1.5s",
            "20 s",
            "9é",
            "99999999999999999999h",
        ] {
            assert!(duration(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn periods_are_written_as_they_are_read() {
        for written in ["0s", "5s", "90s", "2m", "1h", "25h", "8760h"] {
            let period: Period = written.parse().expect("a period");
            assert_eq!(period.to_string(), written);
        }
        let minute = "60s".parse::<Period>().expect("a period");
        assert_eq!(minute.to_string(), "1m", "in the largest unit");
    }

    #[test]
    fn a_year_is_the_longest() {
        for year in ["8760h", "525600m", "31536000s"] {
            assert_eq!(
                duration(year),
                Ok(Duration::from_secs(31_536_000)),
                "{year}"
            );
        }
        for long in [
            "8761h",
            "525601m",
            "31536001s",
            "5124095576030431h",
            "18446744073709551615s",
        ] {
            let told = duration(long).expect_err("too long");
            assert_eq!(
                told,
                format!(
                    "got {long:?}, expected a whole number and s, m or h such as 20s, at most 8760h"
                )
            );
        }
    }
}
