//! What the values of a circular feature are measured in, and the sectors they fall into.

use std::f64::consts::TAU;
use std::str::FromStr;

/// What the values of a circular feature are measured in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Angle {
    /// A turn is 2 pi.
    #[default]
    Radians,
    /// A turn is 360.
    Degrees,
}

impl Angle {
    /// What a unit that says how angles are measured looks like, for error messages.
    pub const UNITS: &'static str = "rad, radians, deg, degrees, ° or none";

    /// Returns what a feature's unit says; without a unit angles are in radians.
    pub fn of_unit(unit: Option<&str>) -> Option<Self> {
        match unit {
            None | Some("rad" | "radians") => Some(Self::Radians),
            Some("deg" | "degrees" | "°") => Some(Self::Degrees),
            Some(_) => None,
        }
    }

    /// Returns the word on the wire.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Radians => "radians",
            Self::Degrees => "degrees",
        }
    }

    /// Returns the one of `bins` equal sectors that an angle lies in; the first is centred on 0.
    #[inline]
    pub(super) fn sector(self, bins: u32, angle: f32) -> u32 {
        let bins = f64::from(bins);
        let position = match self {
            Self::Radians => f64::from(angle) / TAU * bins + 0.5,
            // The remainder is exact, and so is its product with a number of bins: a border belongs
            // to the sector above it, however far round.
            Self::Degrees => f64::from(angle) % 360.0 * bins / 360.0 + 0.5,
        };
        position.floor().rem_euclid(bins) as u32
    }

    /// Returns what people call a sector: its centre, above minus and up to plus half a turn.
    pub(super) fn sector_label(self, bins: u32, bin: u32) -> String {
        let turns = f64::from(bin) / f64::from(bins);
        let turns = if turns > 0.5 { turns - 1.0 } else { turns };
        match self {
            Self::Radians => format!("{:.3}", TAU * turns),
            Self::Degrees => ((360_000.0 * turns).round() / 1_000.0).to_string(),
        }
    }
}

impl FromStr for Angle {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "radians" => Ok(Self::Radians),
            "degrees" => Ok(Self::Degrees),
            _ => Err(format!("got {text:?}, expected radians or degrees")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_wrap_and_the_first_sector_is_centred_on_zero() {
        let sector = |angle| Angle::Radians.sector(8, angle);
        let eighth = std::f32::consts::TAU / 8.0;
        assert_eq!([0.0, -0.3, eighth, -eighth].map(sector), [0, 0, 1, 7]);
        assert_eq!(sector(100.0 * std::f32::consts::TAU + eighth), 1);
        assert!(sector(f32::MAX) < 8);
    }

    #[test]
    fn degrees_land_in_the_sector_that_whole_numbers_give() {
        for bins in [1, 2, 3, 4, 7, 8, 12, 36, 360, 720, 65_536_u32] {
            for angle in (-1_080..=1_080).chain([16_777_215, -16_777_215, 16_777_216]) {
                // floor(angle * bins / 360 + 1/2), modulo the bins, by whole numbers.
                let expected = (i64::from(angle) * 2 * i64::from(bins) + 360)
                    .div_euclid(720)
                    .rem_euclid(i64::from(bins));
                let got = Angle::Degrees.sector(bins, angle as f32);
                assert_eq!(i64::from(got), expected, "{angle} degrees in {bins} bins");
            }
        }
    }

    #[test]
    fn degrees_land_right_at_borders_and_far_out() {
        let sector = |angle| Angle::Degrees.sector(8, angle);
        assert_eq!(
            [-180.0, 180.0, 360.0, 720.0, -0.0].map(sector),
            [4, 4, 0, 0, 0]
        );
        assert_eq!(
            [22.5, 22.499_998, -22.5, -22.500_002, 337.5].map(sector),
            [1, 0, 0, 7, 0]
        );
        // 1e30 as an f32 is 1000000015047466219876688855040, which is 120 modulo 360.
        assert_eq!(sector(1e30), 3);
        assert_eq!(Angle::Degrees.sector(360, 1e30), 120);
        assert_eq!(Angle::Degrees.sector(65_536, f32::MIN_POSITIVE), 0);
        assert!(sector(f32::MAX) < 8 && sector(f32::MIN) < 8);
    }

    #[test]
    fn sectors_are_named_by_their_centres() {
        assert_eq!(
            [0, 1, 2, 3].map(|bin| Angle::Radians.sector_label(4, bin)),
            ["0.000", "1.571", "3.142", "-1.571"]
        );
        assert_eq!(
            [0, 1, 4, 7].map(|bin| Angle::Degrees.sector_label(8, bin)),
            ["0", "45", "180", "-45"]
        );
        assert_eq!(Angle::Degrees.sector_label(7, 1), "51.429");
    }

    #[test]
    fn units_say_how_angles_are_measured() {
        assert_eq!(Angle::of_unit(None), Some(Angle::Radians));
        assert_eq!(
            ["deg", "degrees", "°"].map(|unit| Angle::of_unit(Some(unit))),
            [Some(Angle::Degrees); 3]
        );
        assert_eq!(
            ["Deg", "turns", "grad", "m"].map(|unit| Angle::of_unit(Some(unit))),
            [None; 4]
        );
    }
}
