//! Rate limits: how often a key may ask, by the generic cell rate algorithm (a leaky bucket).

use std::fmt;
use std::num::NonZeroU32;
use std::str::FromStr;
use std::time::Duration;

use governor::clock::{Clock, DefaultClock};
use governor::{DefaultDirectRateLimiter, Quota, RateLimiter};

/// A rate limit: so many requests in a time, all of which may come at once.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rate {
    number: NonZeroU32,
    unit: Unit,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Unit {
    Second,
    Minute,
    Hour,
}

impl FromStr for Rate {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || {
            format!(
                "got {text:?}, expected a number of requests a second, minute or hour such as 50/s, 600/m or 1000/h"
            )
        };

        let (number, unit) = text.split_once('/').ok_or_else(expected)?;
        let unit = match unit {
            "s" => Unit::Second,
            "m" => Unit::Minute,
            "h" => Unit::Hour,
            _ => return Err(expected()),
        };

        let is_number = number.bytes().all(|byte| byte.is_ascii_digit());
        let number = number
            .parse()
            .ok()
            .filter(|_| is_number)
            .ok_or_else(expected)?;

        Ok(Self { number, unit })
    }
}

impl fmt::Display for Rate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let unit = match self.unit {
            Unit::Second => "s",
            Unit::Minute => "m",
            Unit::Hour => "h",
        };
        write!(f, "{}/{unit}", self.number)
    }
}

/// The state of a leaky bucket: how much of a rate is used.
#[derive(Debug)]
pub struct Meter {
    rate: Rate,
    limiter: DefaultDirectRateLimiter,
}

impl Meter {
    /// Begins with everything left.
    pub fn new(rate: Rate) -> Self {
        let quota = match rate.unit {
            Unit::Second => Quota::per_second(rate.number),
            Unit::Minute => Quota::per_minute(rate.number),
            Unit::Hour => Quota::per_hour(rate.number),
        };
        Self {
            rate,
            limiter: RateLimiter::direct(quota),
        }
    }

    /// Returns the rate.
    pub fn rate(&self) -> Rate {
        self.rate
    }

    /// Takes one of the rate, or tells after how long there is one.
    pub fn take(&self) -> Result<(), Duration> {
        self.limiter
            .check()
            .map_err(|not_until| not_until.wait_time_from(DefaultClock::default().now()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_a_number_and_a_unit() {
        for text in ["1/s", "600/m", "4294967295/h"] {
            assert_eq!(
                text.parse::<Rate>().map(|rate| rate.to_string()),
                Ok(text.to_owned())
            );
        }
        for wrong in [
            "",
            "5",
            "/s",
            "0/s",
            "-1/s",
            "+1/s",
            "1/d",
            "1.5/s",
            "4294967296/s",
            "1/s/s",
            " 1/s",
        ] {
            assert!(wrong.parse::<Rate>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn what_is_used_up_comes_back() {
        let meter = Meter::new("3/h".parse().expect("a rate"));
        assert!((0..3).all(|_| meter.take().is_ok()));
        let wait = meter.take().expect_err("used up");
        assert!(
            wait > Duration::from_secs(1_100) && wait <= Duration::from_secs(1_200),
            "{wait:?}"
        );
    }
}
