//! The `state` column: JSON with the players and with what lies about.

use serde::Deserialize;

use super::{Cell, Held, Kitchen, Object, Orientation, Player, Thing};

/// A state as the column holds it.
#[derive(Deserialize)]
struct Written {
    p: [(u8, u8, String, String); 2],
    o: Vec<WrittenObject>,
}

#[derive(Deserialize)]
#[serde(
    untagged,
    expecting = "an object is neither [x, y, name] nor [x, y, \"soup\", items, timer]"
)]
enum WrittenObject {
    Plain(u8, u8, String),
    Soup(u8, u8, String, u8, u32),
}

/// Reads the `state` column, or says what is wrong with it.
pub(super) fn parse_state(
    text: &str,
    kitchen: &Kitchen,
) -> Result<([Player; 2], Vec<Object>), String> {
    let written: Written =
        serde_json::from_str(text).map_err(|error| format!("is no state: {error}"))?;
    let [first, second] = written.p;
    let players = [player(first, kitchen)?, player(second, kitchen)?];
    Ok((
        players,
        written
            .o
            .into_iter()
            .map(object)
            .collect::<Result<_, _>>()?,
    ))
}

fn player(
    (x, y, orientation, held): (u8, u8, String, String),
    kitchen: &Kitchen,
) -> Result<Player, String> {
    if !kitchen.is_walkable(Cell { x, y }) {
        return Err(format!(
            "a player at {x},{y}, where nobody can stand in {}",
            kitchen.name
        ));
    }
    Ok(Player {
        x,
        y,
        orientation: Orientation::parse(&orientation)?,
        held: Held::parse(&held)?,
    })
}

fn object(written: WrittenObject) -> Result<Object, String> {
    let (x, y, thing) = match written {
        WrittenObject::Plain(x, y, name) => (x, y, plain(&name)?),
        WrittenObject::Soup(x, y, name, items, timer)
            if name == "soup" && (1..=3).contains(&items) =>
        {
            (x, y, Thing::Soup { items, timer })
        }
        WrittenObject::Soup(_, _, name, items, _) => {
            return Err(format!(
                "got {name:?} of {items}, expected \"soup\" of 1 to 3"
            ));
        }
    };
    Ok(Object { x, y, thing })
}

fn plain(name: &str) -> Result<Thing, String> {
    match name {
        "onion" => Ok(Thing::Onion),
        "dish" => Ok(Thing::Dish),
        _ => Err(format!("got {name:?}, expected \"onion\" or \"dish\"")),
    }
}
