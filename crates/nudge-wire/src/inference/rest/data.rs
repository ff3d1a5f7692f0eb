//! Deserialization of the values of a tensor as JSON lists them: one flat list, or a list a row.
//!
//! What is no number is remembered rather than refused at once, so that a tensor of another type is
//! told by its type.

use std::fmt;

use nudge_core::error::Fault;
use serde::de::{
    Deserialize, DeserializeSeed, Deserializer, Error, IgnoredAny, MapAccess, SeqAccess, Visitor,
};

use crate::inference::Values;

/// The values of a tensor.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Data {
    values: Vec<f32>,
    /// How many values stand in each row; `None` where they stand in one list.
    width: Option<usize>,
    fault: Option<Fault>,
}

impl From<Data> for Values {
    fn from(data: Data) -> Self {
        match data.fault {
            Some(fault) => Self::Unreadable(fault.under("/data")),
            None => Self::Numbers(data.values, data.width),
        }
    }
}

impl Data {
    /// Takes the next member of the outer list.
    fn take(&mut self, index: usize, item: Item) {
        let (found, expected) = match (item, self.width) {
            (Item::Number, None) => return,
            (Item::Row(width), None) if index == 0 => return self.width = Some(width),
            (Item::Row(found), Some(width)) if found == width => return,
            (Item::Other(pointer, what), _) => {
                return self.refuse(format!("/{index}{pointer}"), what, "a number");
            }
            (Item::Number, Some(_)) => (
                "a number".to_owned(),
                "a list, as the first one is".to_owned(),
            ),
            (Item::Row(found), Some(width)) => (
                format!("{found} values in a row"),
                format!("{width}, as in the first"),
            ),
            (Item::Row(_), None) => (
                "a list".to_owned(),
                "a number, as the first one is".to_owned(),
            ),
        };
        self.refuse(format!("/{index}"), &found, &expected);
    }

    /// Keeps the first fault.
    fn refuse(&mut self, pointer: String, found: &str, expected: &str) {
        self.fault.get_or_insert_with(|| {
            Fault::new(pointer, format!("got {found}, expected {expected}"))
        });
    }
}

impl<'de> Deserialize<'de> for Data {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_seq(Outer)
    }
}

struct Outer;

impl<'de> Visitor<'de> for Outer {
    type Value = Data;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of numbers, or a list of numbers a row")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Data, A::Error> {
        let mut data = Data::default();
        let mut index = 0;
        while let Some(item) = seq.next_element_seed(Member {
            values: &mut data.values,
            in_row: false,
        })? {
            data.take(index, item);
            index += 1;
        }

        Ok(data)
    }
}

/// A member of a list. Its numbers are already among the values.
enum Item {
    Number,
    Row(usize),
    /// Something else: where in the member, and what.
    Other(String, &'static str),
}

fn other<E>(what: &'static str) -> Result<Item, E> {
    Ok(Item::Other(String::new(), what))
}

/// Reads a member of a list, and puts its numbers among the values.
struct Member<'a> {
    values: &'a mut Vec<f32>,
    in_row: bool,
}

impl Member<'_> {
    fn number<E>(self, number: f64) -> Result<Item, E> {
        // Every face rounds to f32 first.
        self.values.push(number as f32);
        Ok(Item::Number)
    }
}

impl<'de> DeserializeSeed<'de> for Member<'_> {
    type Value = Item;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Item, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Member<'_> {
    type Value = Item;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number")
    }

    fn visit_u64<E: Error>(self, number: u64) -> Result<Item, E> {
        self.number(number as f64)
    }

    fn visit_i64<E: Error>(self, number: i64) -> Result<Item, E> {
        self.number(number as f64)
    }

    fn visit_f64<E: Error>(self, number: f64) -> Result<Item, E> {
        self.number(number)
    }

    fn visit_bool<E: Error>(self, flag: bool) -> Result<Item, E> {
        other(if flag { "true" } else { "false" })
    }

    fn visit_unit<E: Error>(self) -> Result<Item, E> {
        other("null")
    }

    fn visit_str<E: Error>(self, _: &str) -> Result<Item, E> {
        other("text")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Item, A::Error> {
        while map.next_entry::<IgnoredAny, IgnoredAny>()?.is_some() {}
        other("an object")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Item, A::Error> {
        if self.in_row {
            while seq.next_element::<IgnoredAny>()?.is_some() {}
            return other("a list");
        }

        let (mut width, mut odd) = (0, None);
        while let Some(item) = seq.next_element_seed(Member {
            values: &mut *self.values,
            in_row: true,
        })? {
            if let Item::Other(_, what) = item {
                odd.get_or_insert(Item::Other(format!("/{width}"), what));
            }
            width += 1;
        }

        Ok(odd.unwrap_or(Item::Row(width)))
    }
}
