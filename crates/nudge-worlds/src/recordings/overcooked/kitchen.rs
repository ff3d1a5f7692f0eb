//! The layouts: where one can walk and where the pots are.

use std::collections::BTreeMap;

/// A cell of a layout, from (0, 0) at the top left.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cell {
    /// The column.
    pub x: u8,
    /// The row.
    pub y: u8,
}

/// One layout. Cells are listed row by row.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Kitchen {
    /// Its name.
    pub name: String,
    /// Where players can stand.
    pub walkable: Vec<Cell>,
    /// Where soup cooks.
    pub pots: Vec<Cell>,
}

impl Kitchen {
    /// Returns the five layouts that the recordings know, in order of name.
    pub fn all() -> Vec<Self> {
        let maps: BTreeMap<String, Vec<String>> =
            serde_json::from_str(include_str!("../../../../../data/overcooked/layouts.json"))
                .expect("the file is part of the program, and a test reads it");
        maps.into_iter()
            .map(|(name, rows)| Self::of_map(name, &rows))
            .collect()
    }

    /// Returns the layout of that name.
    pub fn named(name: &str) -> Option<Self> {
        Self::all().into_iter().find(|kitchen| kitchen.name == name)
    }

    fn of_map(name: String, rows: &[String]) -> Self {
        // 1 and 2 are where players start.
        Self {
            name,
            walkable: cells(rows, " 12"),
            pots: cells(rows, "P"),
        }
    }

    /// Returns whether a player can stand there.
    pub fn is_walkable(&self, cell: Cell) -> bool {
        self.walkable.contains(&cell)
    }
}

fn cells(rows: &[String], signs: &str) -> Vec<Cell> {
    let row = |(y, row): (usize, &String)| {
        let found: Vec<usize> = row
            .char_indices()
            .filter(|(_, sign)| signs.contains(*sign))
            .map(|(x, _)| x)
            .collect();
        found.into_iter().map(move |x| Cell {
            x: x as u8,
            y: y as u8,
        })
    };
    rows.iter().enumerate().flat_map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_layouts_are_those_of_the_recordings() {
        let sizes: Vec<_> = Kitchen::all()
            .into_iter()
            .map(|k| (k.name, k.walkable.len(), k.pots.len()))
            .collect();
        let expected = [
            ("asymmetric_advantages", 14, 2),
            ("coordination_ring", 8, 2),
            ("counter_circuit", 14, 2),
            ("cramped_room", 6, 1),
            ("forced_coordination", 6, 2),
        ];
        assert_eq!(
            sizes,
            expected.map(|(name, walkable, pots)| (name.to_owned(), walkable, pots))
        );
    }

    #[test]
    fn cells_are_counted_from_the_top_left() {
        let kitchen = Kitchen::named("cramped_room").expect("known");
        assert_eq!(kitchen.pots, [Cell { x: 2, y: 0 }]);
        assert_eq!(kitchen.walkable[0], Cell { x: 1, y: 1 });
        assert!(!kitchen.is_walkable(Cell { x: 0, y: 0 }));
    }
}
