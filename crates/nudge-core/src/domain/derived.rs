//! Derived features: differences, Manhattan distances and equalities of features of the state, as
//! functions of its bins alone. Questions are asked in them; nothing is counted by them, and the
//! schema hash does not know them.

use std::sync::Arc;

use super::checked::{Faults, LARGEST_INTEGER, unique};
use super::draft::{DerivedDraft, DerivedKindDraft};
use super::near::hint_after;
use super::{FeatureKind, Label, LabelSet, Name, Schema, StateKey};
use crate::error::Fault;

const MOST_DERIVED: usize = 64;
const MOST_PAIRS: usize = 16;

/// The derived features of an environment, in order. Cloning is cheap.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DerivedFeatures(Arc<[DerivedFeature]>);

/// One coordinate that follows from a state's bins. Made only by [`DerivedFeatures::checked`].
#[derive(Debug, Clone, PartialEq)]
pub struct DerivedFeature {
    /// Unique among the features, agents and outcomes of its environment.
    pub name: Name,
    /// Its alphabet: whole numbers, an angle's sectors, or the labels `false` and `true`.
    pub kind: FeatureKind,
    function: Function,
}

/// What a derived feature is of a state's bins. Cloning is cheap.
#[derive(Debug, Clone, PartialEq)]
enum Function {
    /// a - b of whole numbers, and the least that it can be.
    Difference(Operands, i64),
    /// a - b of angles on a circle of so many sectors.
    Rotation(Operands, u32),
    /// sum |a - b| of whole numbers, and the least that it can be.
    Manhattan(Arc<[Operands]>, i64),
    /// Whether a is b.
    Equal(Operands),
}

/// Two features of the state by their positions.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Operands {
    a: usize,
    b: usize,
    /// The value of the first bin of a less that of b; 0 where values are no numbers.
    offset: i64,
}

impl DerivedFeatures {
    /// Returns the derived features that drafts mean for states of a schema, or every fault by its
    /// pointer, `/derived/0/difference/1`.
    pub fn checked(drafts: &[DerivedDraft], schema: &Schema) -> Result<Self, Vec<Fault>> {
        let mut faults = Faults::default();
        faults.size(
            "/derived".into(),
            "features",
            drafts.len(),
            0..=MOST_DERIVED,
        );
        one_namespace(drafts, schema, &mut faults);

        let mut derived = Vec::new();
        for (i, draft) in drafts.iter().enumerate().take(MOST_DERIVED) {
            derived.extend(feature(
                &format!("/derived/{i}"),
                draft,
                schema,
                &mut faults,
            ));
        }
        faults.into_result().map(|()| Self(derived.into()))
    }

    /// Returns them as they would be described.
    pub fn draft(&self, schema: &Schema) -> Vec<DerivedDraft> {
        self.0.iter().map(|feature| feature.draft(schema)).collect()
    }
}

impl std::ops::Deref for DerivedFeatures {
    type Target = [DerivedFeature];

    fn deref(&self) -> &[DerivedFeature] {
        &self.0
    }
}

impl DerivedFeature {
    /// Returns the bin of a state.
    #[inline]
    pub fn bin(&self, key: &StateKey) -> u32 {
        self.function.bin(key.bins())
    }

    /// Returns how it follows from the state, for people: `player_1.x - player_0.x`.
    pub fn formula(&self, schema: &Schema) -> String {
        let name = |at: usize| schema.state()[at].name.as_str();
        let difference = |of: &Operands| format!("{} - {}", name(of.a), name(of.b));
        match &self.function {
            Function::Difference(of, _) | Function::Rotation(of, _) => difference(of),
            Function::Equal(of) => format!("{} = {}", name(of.a), name(of.b)),
            Function::Manhattan(pairs, _) => {
                let terms = pairs.iter().map(|of| format!("|{}|", difference(of)));
                terms.collect::<Vec<_>>().join(" + ")
            }
        }
    }

    fn draft(&self, schema: &Schema) -> DerivedDraft {
        let pair = |of: &Operands| [of.a, of.b].map(|at| schema.state()[at].name.to_string());
        let kind = match &self.function {
            Function::Difference(of, _) | Function::Rotation(of, _) => {
                DerivedKindDraft::Difference(pair(of).to_vec())
            }
            Function::Manhattan(pairs, _) => {
                DerivedKindDraft::Manhattan(pairs.iter().map(|of| pair(of).to_vec()).collect())
            }
            Function::Equal(of) => DerivedKindDraft::Equal(pair(of).to_vec()),
        };
        DerivedDraft {
            name: self.name.to_string(),
            kinds: vec![kind],
        }
    }
}

impl Function {
    #[inline]
    fn bin(&self, bins: &[u32]) -> u32 {
        match self {
            Self::Difference(of, least) => (of.difference(bins) - least) as u32,
            Self::Rotation(of, sectors) => {
                of.difference(bins).rem_euclid(i64::from(*sectors)) as u32
            }
            Self::Manhattan(pairs, least) => {
                let distance: i64 = pairs.iter().map(|of| of.difference(bins).abs()).sum();
                (distance - least) as u32
            }
            Self::Equal(of) => u32::from(of.difference(bins) == 0),
        }
    }
}

impl Operands {
    #[inline]
    fn difference(&self, bins: &[u32]) -> i64 {
        i64::from(bins[self.a]) - i64::from(bins[self.b]) + self.offset
    }
}

/// Features, agents, outcomes and derived features are asked about by name.
fn one_namespace(drafts: &[DerivedDraft], schema: &Schema, faults: &mut Faults) {
    let features = schema.state().iter().map(|feature| feature.name.as_str());
    let agents = schema.agents().iter().map(|agent| agent.name.as_str());
    let outcomes = schema.outcomes().iter().map(|outcome| &*outcome.name);
    let known = features.chain(agents).chain(outcomes);

    let derived = drafts.iter().enumerate();
    let derived = derived.map(|(i, draft)| (format!("/derived/{i}/name"), &*draft.name));
    unique(
        known.map(|name| (String::new(), name)).chain(derived),
        faults,
    );
}

fn feature(
    pointer: &str,
    draft: &DerivedDraft,
    schema: &Schema,
    faults: &mut Faults,
) -> Option<DerivedFeature> {
    let name: Option<Name> = faults.parse(format!("{pointer}/name"), &draft.name);
    let function = match draft.kinds.as_slice() {
        [DerivedKindDraft::Difference(names)] => {
            let pointer = format!("{pointer}/difference");
            difference(&pointer, names, schema, faults)
        }
        [DerivedKindDraft::Manhattan(pairs)] => {
            let pointer = format!("{pointer}/manhattan");
            manhattan(&pointer, pairs, schema, faults)
        }
        [DerivedKindDraft::Equal(names)] => {
            let pointer = format!("{pointer}/equal");
            equal(&pointer, names, schema, faults)
        }
        kinds => {
            let got = kinds.len();
            let detail = format!("got {got} kinds, expected one of difference, manhattan, equal");
            faults.add(pointer, detail);
            None
        }
    };

    let (kind, function) = function?;
    Some(DerivedFeature {
        name: name?,
        kind,
        function,
    })
}

type Found = Option<(FeatureKind, Function)>;

/// Bins of whole numbers and sectors of angles are equally wide, so that their bins have
/// differences; bins between edges have none, and labels no order.
fn difference(pointer: &str, names: &[String], schema: &Schema, faults: &mut Faults) -> Found {
    let [a, b] = pair(pointer, names, schema, faults)?;
    match [a, b].map(|at| &schema.state()[at].kind) {
        [FeatureKind::Integer(..), FeatureKind::Integer(..)] => {
            let (of, [least, most]) = whole_numbers([a, b], schema)?;
            let kind = within(pointer, least, most, faults)?;
            Some((kind, Function::Difference(of, least)))
        }
        [one @ FeatureKind::Circular(sectors, angle), other] if one == other => {
            let of = Operands { a, b, offset: 0 };
            let kind = FeatureKind::Circular(*sectors, *angle);
            Some((kind, Function::Rotation(of, *sectors)))
        }
        kinds => {
            let [a, b] = kinds.map(FeatureKind::as_str);
            let detail = format!(
                "got {a} and {b} features, expected two integer ones, or two circular ones with the same bins and unit: others have no differences"
            );
            faults.add(pointer, detail);
            None
        }
    }
}

fn manhattan(pointer: &str, pairs: &[Vec<String>], schema: &Schema, faults: &mut Faults) -> Found {
    faults.size(pointer.into(), "pairs", pairs.len(), 1..=MOST_PAIRS);
    let mut terms = Vec::new();
    for (i, names) in pairs.iter().enumerate().take(MOST_PAIRS) {
        let pointer = format!("{pointer}/{i}");
        let Some(pair) = pair(&pointer, names, schema, faults) else {
            continue;
        };
        match whole_numbers(pair, schema) {
            Some(term) => terms.push(term),
            None => {
                let [a, b] = pair.map(|at| schema.state()[at].kind.as_str());
                let detail = format!("got {a} and {b} features, expected two integer ones");
                faults.add(pointer, detail);
            }
        }
    }

    if pairs.is_empty() || terms.len() < pairs.len() {
        return None;
    }
    let least = terms
        .iter()
        .map(|(_, [lo, hi])| (*lo).max(-hi).max(0))
        .sum();
    let most = terms.iter().map(|(_, [lo, hi])| (*hi).max(-lo)).sum();
    let kind = within(pointer, least, most, faults)?;
    let of = terms.into_iter().map(|(of, _)| of).collect();
    Some((kind, Function::Manhattan(of, least)))
}

fn equal(pointer: &str, names: &[String], schema: &Schema, faults: &mut Faults) -> Found {
    let [a, b] = pair(pointer, names, schema, faults)?;
    let [one, other] = [a, b].map(|at| &schema.state()[at].kind);
    let of = match whole_numbers([a, b], schema) {
        Some((of, _)) => of,
        // The same bins mean the same.
        None if one == other => Operands { a, b, offset: 0 },
        None => {
            let detail = format!(
                "got {} and {} features, expected two with the same labels, edges or sectors, or two integer ones",
                one.as_str(),
                other.as_str()
            );
            faults.add(pointer, detail);
            return None;
        }
    };
    Some((FeatureKind::Categorical(truth()), Function::Equal(of)))
}

fn truth() -> LabelSet {
    let label = |text: &str| text.parse::<Label>().expect("a word is a label");
    ["false", "true"].map(label).into_iter().collect()
}

/// Returns the positions of two features of the state.
fn pair(
    pointer: &str,
    names: &[String],
    schema: &Schema,
    faults: &mut Faults,
) -> Option<[usize; 2]> {
    let [a, b] = names else {
        let detail = format!("got {} names, expected those of two features", names.len());
        faults.add(pointer, detail);
        return None;
    };

    let [a, b] =
        [(0, a), (1, b)].map(|(i, name)| position(&format!("{pointer}/{i}"), name, schema, faults));
    let (a, b) = a.zip(b)?;
    if a == b {
        let name = &schema.state()[a].name;
        let detail = format!("got {:?} twice, expected two features", name.as_str());
        faults.add(pointer, detail);
        return None;
    }
    Some([a, b])
}

fn position(pointer: &str, name: &str, schema: &Schema, faults: &mut Faults) -> Option<usize> {
    let known = schema.state().iter().map(|feature| feature.name.as_str());
    let known: Vec<&str> = known.collect();
    let found = known.iter().position(|known| *known == name);
    if found.is_none() {
        let hint = hint_after(faults.len(), name, &known);
        faults.add(
            pointer,
            format!("unknown feature {name:?} of the state{hint}"),
        );
    }
    found
}

/// Returns two integer features, and from what to what their difference goes.
fn whole_numbers([a, b]: [usize; 2], schema: &Schema) -> Option<(Operands, [i64; 2])> {
    let [one, other] = [a, b].map(|at| &schema.state()[at].kind);
    let (FeatureKind::Integer(min_a, max_a), FeatureKind::Integer(min_b, max_b)) = (one, other)
    else {
        return None;
    };
    let [min_a, max_a, min_b, max_b] = [min_a, max_a, min_b, max_b].map(|of| i64::from(*of));
    let of = Operands {
        a,
        b,
        offset: min_a - min_b,
    };
    Some((of, [min_a - max_b, max_a - min_b]))
}

/// Returns the whole numbers from one to another, if an integer feature may have them.
fn within(pointer: &str, least: i64, most: i64, faults: &mut Faults) -> Option<FeatureKind> {
    let whole = |number: i64| {
        let number = Some(number).filter(|number| number.unsigned_abs() <= LARGEST_INTEGER)?;
        i32::try_from(number).ok()
    };
    let found = whole(least).zip(whole(most));
    if found.is_none() {
        let detail = format!("goes from {least} to {most}, expected from -16777216 to 16777216");
        faults.add(pointer, detail);
    }
    found.map(|(least, most)| FeatureKind::Integer(least, most))
}

#[cfg(test)]
mod tests;
