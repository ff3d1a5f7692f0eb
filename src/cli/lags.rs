//! The lags that recorded and simulated play is sent with.

use std::collections::BTreeSet;
use std::fmt;
use std::str::FromStr;

use super::Failure;
use crate::client::{ClientError, Connection};
use crate::domain::MOST_LAG;
use crate::error::ErrorKind;

/// Lags in order, each once; none for play whose actions are asked about in one tick alone.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Lags(Vec<u32>);

impl Default for Lags {
    /// Two to three seconds of play: people answer after 2 to 12 ticks.
    fn default() -> Self {
        Self((1..=12).collect())
    }
}

impl<const N: usize> From<[u32; N]> for Lags {
    fn from(lags: [u32; N]) -> Self {
        Self(BTreeSet::from(lags).into_iter().collect())
    }
}

impl Lags {
    /// Returns no lags.
    pub(super) fn none() -> Self {
        Self(Vec::new())
    }

    /// Returns the numbers.
    pub(super) fn numbers(&self) -> &[u32] {
        &self.0
    }

    /// Refuses an environment that is there without outcomes, in which nothing of them would be
    /// counted; `other` says how another is named.
    pub(super) async fn check(
        &self,
        connection: &Connection,
        name: &str,
        other: &str,
    ) -> Result<(), Failure> {
        if self.0.is_empty() {
            return Ok(());
        }
        let found = match connection.environment(name).await {
            Ok(found) => found,
            Err(ClientError::Refused(refusal)) if refusal.kind == ErrorKind::NotFound => {
                return Ok(());
            }
            Err(error) => return Err(error.into()),
        };
        match found.schema {
            Some(schema) if schema.outcomes.is_empty() => Err(Failure::usage(format!(
                "`{name}` is there without outcomes, which are fixed with an environment: give --lags none to send it as it is, or {other} for another"
            ))),
            _ => Ok(()),
        }
    }
}

impl fmt::Display for Lags {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.is_empty() {
            return f.write_str("none");
        }
        let runs = self.0.chunk_by(|one, next| one + 1 == *next);
        let run = |run: &[u32]| match run {
            [first, .., last] => format!("{first}..{last}"),
            only => only.iter().map(ToString::to_string).collect(),
        };
        f.write_str(&runs.map(run).collect::<Vec<_>>().join(","))
    }
}

impl FromStr for Lags {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "none" {
            return Ok(Self::none());
        }
        let wrong =
            || format!("expected none, or lags from 1 to {MOST_LAG}, such as 1..12 or 1,2,3");
        let number = |text: &str| {
            let number: u32 = text.trim().parse().map_err(|_| wrong())?;
            (1..=MOST_LAG)
                .contains(&number)
                .then_some(number)
                .ok_or_else(wrong)
        };

        let mut lags = BTreeSet::new();
        for part in text.split(',') {
            let (first, last) = part.split_once("..").unwrap_or((part, part));
            let (first, last) = (number(first)?, number(last)?);
            if first > last {
                return Err(wrong());
            }
            lags.extend(first..=last);
        }
        Ok(Self(lags.into_iter().collect()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lags_are_read_and_told() {
        for (text, told, numbers) in [
            ("none", "none", vec![]),
            ("1..12", "1..12", (1..=12).collect()),
            ("3", "3", vec![3]),
            ("4,1, 2,2..3,64", "1..4,64", vec![1, 2, 3, 4, 64]),
            ("7..7,9", "7,9", vec![7, 9]),
        ] {
            let lags: Lags = text.parse().expect("lags");
            assert_eq!(
                (lags.to_string().as_str(), lags.numbers()),
                (told, &numbers[..])
            );
        }
        assert_eq!(Lags::default().to_string(), "1..12");
    }

    #[test]
    fn what_is_no_lag_is_refused() {
        for text in [
            "", "0", "65", "1..65", "3..1", "1..", "..3", "-1", "1.5", "all", "1,,2", "none,1",
            "1..2..3",
        ] {
            let wrong = text.parse::<Lags>().expect_err(text);
            assert!(wrong.contains("1 to 64"), "{text}: {wrong}");
        }
    }
}
