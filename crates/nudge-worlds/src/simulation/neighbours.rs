//! Who may feel whom: lists of near neighbours that stay complete for several steps, so that a
//! crowd costs what its pairs in reach cost.

use glam::DVec2;
use kdtree::KdTree;
use kdtree::distance::squared_euclidean;
use rayon::prelude::*;

/// From this size on a crowd is searched through an index. Measured: as quick as looking at
/// everyone at 50, a sixth quicker at 100.
const INDEXED_FROM: usize = 64;

/// How much farther than needed a search goes, in m: enough for some 13 steps of 0.05 s of a crowd
/// whose fastest walks at 2.3 m/s. A skin of 1 or 2 m made 10,000 pedestrians slower, for they
/// searched more often.
const SKIN: f64 = 3.0;

/// Places in a leaf of the index, measured.
const LEAF: usize = 32;

/// The neighbours of everyone, in the crowd's order, complete within a radius.
#[derive(Debug, Clone, Default)]
pub(super) struct Neighbours {
    lists: Vec<Vec<u32>>,
    complete_within: f64,
}

impl Neighbours {
    /// Lists who can be felt within `reach` m, and for a while longer.
    pub(super) fn search(places: &[DVec2], reach: f64) -> Self {
        if places.len() < INDEXED_FROM {
            Self::everyone(places.len())
        } else {
            Self::within(places, reach + SKIN)
        }
    }

    /// Lists everyone for everyone.
    pub(super) fn everyone(size: usize) -> Self {
        let others = |i| (0..size as u32).filter(|j| *j != i).collect();
        Self {
            lists: (0..size as u32).map(others).collect(),
            complete_within: f64::INFINITY,
        }
    }

    /// A k-d tree that halves the longer side: a hallway is long and thin, and trees that take the
    /// sides in turn search most of it in vain.
    fn within(places: &[DVec2], radius: f64) -> Self {
        const FINITE: &str = "pedestrians are at finite places";
        let mut index = KdTree::with_capacity(2, LEAF);
        for (i, place) in (0..).zip(places) {
            index.add(place.to_array(), i).expect(FINITE);
        }

        let near = |(i, place): (usize, &DVec2)| {
            let found = index
                .within(&place.to_array(), radius * radius, &squared_euclidean)
                .expect(FINITE);
            let mut others: Vec<u32> = found
                .into_iter()
                .map(|(_, j)| *j)
                .filter(|j| *j as usize != i)
                .collect();
            others.sort_unstable();
            others
        };
        Self {
            lists: places.par_iter().enumerate().map(near).collect(),
            complete_within: radius,
        }
    }

    /// Returns who may be within reach of the `i`th, in the crowd's order.
    pub(super) fn candidates(&self, i: usize) -> &[u32] {
        &self.lists[i]
    }

    /// Returns whether nobody within `reach` of another is missing.
    pub(super) fn cover(&self, reach: f64) -> bool {
        reach <= self.complete_within
    }

    /// Remembers that two may have come nearer to each other by `way` m.
    pub(super) fn approach(&mut self, way: f64) {
        self.complete_within -= way;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn places() -> impl Strategy<Value = Vec<DVec2>> {
        // Whole coordinates put many at the same place and many exactly on the radius.
        let place = prop_oneof![
            (-60.0..60.0, 0.0..4.0).prop_map(|(x, y)| DVec2::new(x, y)),
            (-20_i8..20, 0_i8..4).prop_map(|(x, y): (i8, i8)| DVec2::new(x.into(), y.into())),
        ];
        prop::collection::vec(place, 0..400)
    }

    proptest! {
        #[test]
        fn nobody_within_the_radius_is_missed(places in places(), radius in 0_u32..15) {
            let radius = f64::from(radius);
            let neighbours = Neighbours::within(&places, radius);
            for (i, place) in places.iter().enumerate() {
                let near = |j: &u32| *j as usize != i && places[*j as usize].distance_squared(*place) <= radius * radius;
                let expected: Vec<u32> = (0..places.len() as u32).filter(near).collect();
                prop_assert_eq!(neighbours.candidates(i), expected);
            }
        }
    }

    #[test]
    fn a_crowd_at_one_place_is_searched_too() {
        let neighbours = Neighbours::within(&[DVec2::ONE; 200], 0.5);

        assert!((0..200).all(|i| neighbours.candidates(i).len() == 199));
    }

    #[test]
    fn a_search_covers_its_reach_until_its_skin_is_walked_off() {
        let mut neighbours = Neighbours::search(&[DVec2::ZERO; INDEXED_FROM], 8.0);
        assert!(neighbours.cover(11.0) && !neighbours.cover(11.1));

        neighbours.approach(1.5);
        assert!(neighbours.cover(9.5) && !neighbours.cover(9.6));
    }

    #[test]
    fn everyone_is_everyone_for_ever() {
        let mut neighbours = Neighbours::search(&[DVec2::ZERO; 3], 8.0);
        neighbours.approach(1e9);

        assert!(neighbours.cover(1e9));
        assert_eq!(
            [0, 1, 2].map(|i| neighbours.candidates(i)),
            [[1, 2], [0, 2], [0, 1]]
        );
    }

    #[test]
    fn the_lists_of_nobody_cover_nothing() {
        assert!(!Neighbours::default().cover(0.1));
    }
}
