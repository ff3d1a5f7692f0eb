//! Walls: straight pieces of which a pedestrian feels the nearest point.

use glam::DVec2;

/// A straight piece of wall between two points, in m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segment {
    /// One end.
    pub from: DVec2,
    /// The other end.
    pub to: DVec2,
}

/// One wall, in one piece or broken by doorways: only the nearest point of all its pieces is felt.
#[derive(Debug, Clone, PartialEq)]
pub struct Wall {
    /// What stands of it.
    pub pieces: Vec<Segment>,
}

/// As good as endless, in m, and small enough that coordinates keep ten decimals.
const FAR: f64 = 1e6;

impl Wall {
    /// Makes a wall along y, endless in x.
    pub fn along(y: f64) -> Self {
        Self {
            pieces: vec![Segment {
                from: DVec2::new(-FAR, y),
                to: DVec2::new(FAR, y),
            }],
        }
    }

    /// Returns the vector from the wall's nearest point to `position`; of a wall without pieces,
    /// one beyond all range.
    pub fn away(&self, position: DVec2) -> DVec2 {
        let vectors = self.pieces.iter().map(|piece| piece.away(position));
        vectors
            .min_by(|a, b| a.length_squared().total_cmp(&b.length_squared()))
            .unwrap_or(DVec2::INFINITY)
    }
}

impl Segment {
    /// Returns the vector from the nearest point to `position`.
    fn away(&self, position: DVec2) -> DVec2 {
        let whole = self.to - self.from;
        let along = whole.normalize_or_zero();
        let from_end = position - self.from;
        from_end - from_end.dot(along).clamp(0.0, whole.length()) * along
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_point_of_a_piece_is_across_from_it_or_its_end() {
        let piece = Segment {
            from: DVec2::new(1.0, 1.0),
            to: DVec2::new(3.0, 1.0),
        };

        assert_eq!(piece.away(DVec2::new(2.0, 1.5)), DVec2::new(0.0, 0.5));
        assert_eq!(piece.away(DVec2::new(2.0, 0.25)), DVec2::new(0.0, -0.75));
        assert_eq!(piece.away(DVec2::new(4.0, 3.0)), DVec2::new(1.0, 2.0));
        assert_eq!(piece.away(DVec2::new(0.5, 1.0)), DVec2::new(-0.5, 0.0));
    }

    #[test]
    fn a_piece_without_length_is_a_post() {
        let post = Segment {
            from: DVec2::ONE,
            to: DVec2::ONE,
        };

        assert_eq!(post.away(DVec2::new(2.0, 3.0)), DVec2::new(1.0, 2.0));
    }

    #[test]
    fn an_endless_wall_pushes_straight_across_wherever_one_stands() {
        for x in [-50.0, 0.0, 0.1, 12.345_678, 5_000.0] {
            assert_eq!(
                Wall::along(4.0).away(DVec2::new(x, 3.5)),
                DVec2::new(0.0, -0.5)
            );
        }
    }

    #[test]
    fn of_a_wall_with_a_doorway_the_nearer_post_is_felt() {
        let piece = |from: f64, to: f64| Segment {
            from: DVec2::new(10.0, from),
            to: DVec2::new(10.0, to),
        };
        let wall = Wall {
            pieces: vec![piece(0.0, 1.5), piece(2.5, 4.0)],
        };

        assert_eq!(wall.away(DVec2::new(10.0, 1.75)), DVec2::new(0.0, 0.25));
        assert_eq!(wall.away(DVec2::new(10.0, 2.25)), DVec2::new(0.0, -0.25));
        assert_eq!(wall.away(DVec2::new(9.0, 3.0)), DVec2::new(-1.0, 0.0));
    }
}
