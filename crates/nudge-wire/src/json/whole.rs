//! Whole numbers of requests. JSON has no integers: `8.0` is 8, as JSON Schema has it and some
//! writers put it, and 8.5 is refused.

use std::fmt;
use std::marker::PhantomData;

use serde::de::{Deserialize, Deserializer, Error, Unexpected, Visitor};

/// Up to here f64 tells neighbouring whole numbers apart.
const EXACT: f64 = 9_007_199_254_740_992.0;

/// Decodes a whole number.
pub fn whole<'de, T: TryFrom<u64> + TryFrom<i64>, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<T, D::Error> {
    Whole::deserialize(deserializer).map(|whole| whole.0)
}

/// Decodes a whole number that may be left out; null means that it is.
pub fn perhaps_whole<'de, T: TryFrom<u64> + TryFrom<i64>, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<T>, D::Error> {
    Option::<Whole<T>>::deserialize(deserializer).map(|whole| whole.map(|whole| whole.0))
}

/// Decodes a list of whole numbers.
pub fn wholes<'de, T: TryFrom<u64> + TryFrom<i64>, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Vec<T>, D::Error> {
    Vec::<Whole<T>>::deserialize(deserializer)
        .map(|wholes| wholes.into_iter().map(|whole| whole.0).collect())
}

/// Reads a list of whole numbers that may be null, for none.
pub fn wholes_if_any<'de, T: TryFrom<u64> + TryFrom<i64>, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Vec<T>, D::Error> {
    let wholes = Option::<Vec<Whole<T>>>::deserialize(deserializer)?;
    let wholes = wholes.unwrap_or_default().into_iter();
    Ok(wholes.map(|whole| whole.0).collect())
}

struct Whole<T>(T);

impl<'de, T: TryFrom<u64> + TryFrom<i64>> Deserialize<'de> for Whole<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(AnyNumber(PhantomData))
    }
}

struct AnyNumber<T>(PhantomData<T>);

impl<T: TryFrom<u64> + TryFrom<i64>> Visitor<'_> for AnyNumber<T> {
    type Value = Whole<T>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let is_signed = T::try_from(-1_i64).is_ok();
        f.write_str(if is_signed {
            "a whole number"
        } else {
            "a whole number, at least 0"
        })
    }

    fn visit_u64<E: Error>(self, number: u64) -> Result<Whole<T>, E> {
        let whole = T::try_from(number).map(Whole);
        whole.map_err(|_| E::invalid_value(Unexpected::Unsigned(number), &self))
    }

    fn visit_i64<E: Error>(self, number: i64) -> Result<Whole<T>, E> {
        let whole = T::try_from(number).map(Whole);
        whole.map_err(|_| E::invalid_value(Unexpected::Signed(number), &self))
    }

    fn visit_f64<E: Error>(self, number: f64) -> Result<Whole<T>, E> {
        match number.fract() == 0.0 && number.abs() <= EXACT {
            true => self.visit_i64(number as i64),
            false => Err(E::invalid_type(Unexpected::Float(number), &self)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unsigned(text: &str) -> Result<u64, String> {
        whole(&mut serde_json::Deserializer::from_str(text)).map_err(|error| error.to_string())
    }

    #[test]
    fn what_is_whole_is_an_integer_however_it_is_written() {
        let numbers = [
            "8",
            "8.0",
            "8e0",
            "80e-1",
            "0.0",
            "-0.0",
            "18446744073709551615",
            "9007199254740992.0",
        ];
        let read = [8, 8, 8, 8, 0, 0, u64::MAX, 1 << 53];
        assert_eq!(numbers.map(|number| unsigned(number).expect(number)), read);
        let signed: Vec<i64> =
            wholes(&mut serde_json::Deserializer::from_str("[-3.0, -3, 1e2]")).expect("whole");
        assert_eq!(signed, [-3, -3, 100]);
        let absent: Option<u64> =
            perhaps_whole(&mut serde_json::Deserializer::from_str("null")).expect("absent");
        assert_eq!(absent, None);
    }

    #[test]
    fn what_is_not_whole_is_refused() {
        for (wrong, found) in [
            ("8.5", "8.5"),
            ("-1.0", "-1"),
            ("-1", "-1"),
            ("1e300", "1e+300"),
            ("\"8\"", "\"8\""),
            ("null", "null"),
        ] {
            let told = unsigned(wrong).expect_err(wrong);
            assert!(
                told.contains(found) && told.contains("expected a whole number, at least 0"),
                "{told}"
            );
        }
    }
}
