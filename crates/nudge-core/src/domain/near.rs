//! Names near one that is not known, by edit distance (optimal string alignment): what somebody who
//! mistyped it may have meant.

/// Names that are told.
const TOLD: usize = 3;

/// So few are all told where none is near.
const FEW: usize = 8;

/// Names that are compared, and letters of a name that is: nobody can keep a service busy by asking
/// for long names among many.
const MOST_COMPARED: usize = 2_000;
const MOST_LETTERS: usize = 64;

/// Returns what is added to "unknown environment `halway`": the names near it, or all if they are
/// few; nothing where neither helps.
pub fn hint<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    let known: Vec<&str> = known.into_iter().take(MOST_COMPARED).collect();
    let near = near(name, &known);
    match near.is_empty() {
        false => format!("; did you mean {}?", alternatives(&near)),
        true if known.is_empty() || known.len() > FEW => String::new(),
        true => format!("; known: {}", listed(&known)),
    }
}

/// Returns what [`hint`] does, and nothing where so many faults are told already that looking for
/// each would keep a service busy.
pub fn hint_after(faults: usize, name: &str, known: &[&str]) -> String {
    const MOST_HINTS: usize = 100;
    match faults < MOST_HINTS {
        true => hint(name, known.iter().copied()),
        false => String::new(),
    }
}

/// Returns whether a name may have been meant by another.
pub fn is_near(name: &str, known: &str) -> bool {
    !near(name, &[known]).is_empty()
}

/// Returns "; did you mean `a`, `b` or `c`?" of the first names; nothing where there are none.
pub fn meant(names: &[&str]) -> String {
    match &names[..names.len().min(TOLD)] {
        [] => String::new(),
        first => format!("; did you mean {}?", alternatives(first)),
    }
}

/// Returns the names near one, the nearest first: of those that hold it, or that it holds, and
/// those that are a few edits away.
fn near<'a>(name: &str, known: &[&'a str]) -> Vec<&'a str> {
    let letters: Vec<char> = name.to_lowercase().chars().collect();
    if letters.is_empty() || letters.len() > MOST_LETTERS {
        return Vec::new();
    }

    let mut ranked: Vec<(usize, &str)> = known
        .iter()
        .filter_map(|known| Some((distance_if_near(&letters, known)?, *known)))
        .collect();
    ranked.sort_unstable();

    ranked
        .into_iter()
        .map(|(_, known)| known)
        .take(TOLD)
        .collect()
}

/// Returns how many edits away a known name is, if those are few for its length or one holds the
/// other.
fn distance_if_near(letters: &[char], known: &str) -> Option<usize> {
    /// Shorter names are in too many others.
    const HELD: usize = 3;

    let other: Vec<char> = known.to_lowercase().chars().collect();
    let [shorter, longer] = if letters.len() <= other.len() {
        [letters, &other]
    } else {
        [&other, letters]
    };

    let difference = longer.len() - shorter.len();
    if shorter.len() >= HELD && longer.windows(shorter.len()).any(|part| part == shorter) {
        return Some(difference);
    }

    // A third of the letters, or one.
    let allowed = (longer.len() / 3).max(1);
    if longer.len() > MOST_LETTERS || difference > allowed {
        return None;
    }
    Some(distance(shorter, longer)).filter(|edits| *edits <= allowed && *edits < longer.len())
}

/// Returns the optimal string alignment distance: insertions, deletions, substitutions, and swaps
/// of neighbours (Damerau 1964).
fn distance(one: &[char], other: &[char]) -> usize {
    let mut rows = [
        vec![0; other.len() + 1],
        (0..=other.len()).collect(),
        vec![0; other.len() + 1],
    ];

    for (i, a) in one.iter().enumerate() {
        let [before, last, now] = &mut rows;
        now[0] = i + 1;
        for (j, b) in other.iter().enumerate() {
            let edited = (last[j] + usize::from(a != b))
                .min(last[j + 1] + 1)
                .min(now[j] + 1);

            let is_swap = i > 0 && j > 0 && *a == other[j - 1] && one[i - 1] == *b;
            now[j + 1] = if is_swap {
                edited.min(before[j - 1] + 1)
            } else {
                edited
            };
        }
        rows.rotate_left(1);
    }
    rows[1][other.len()]
}

/// Returns "`a`, `b` or `c`".
fn alternatives(names: &[&str]) -> String {
    match names {
        [others @ .., last] if !others.is_empty() => format!("{} or `{last}`", listed(others)),
        _ => listed(names),
    }
}

fn listed(names: &[&str]) -> String {
    names
        .iter()
        .map(|name| format!("`{name}`"))
        .collect::<Vec<_>>()
        .join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn edits(one: &str, other: &str) -> usize {
        distance(
            &one.chars().collect::<Vec<_>>(),
            &other.chars().collect::<Vec<_>>(),
        )
    }

    #[test]
    fn edits_are_counted() {
        // The first four are the examples of Wagner and Fischer, and of Damerau.
        let cases = [
            ("kitten", "sitting", 3),
            ("ca", "ac", 1),
            ("", "abc", 3),
            ("abc", "", 3),
            ("ab", "ab", 0),
        ];
        for (one, other, expected) in cases {
            assert_eq!(
                (edits(one, other), edits(other, one)),
                (expected, expected),
                "{one} {other}"
            );
        }
        assert_eq!(edits("ca", "abc"), 3, "no letter is edited twice");
    }

    #[test]
    fn what_is_near_is_told() {
        let known = [
            "hallway",
            "hallway-2",
            "cramped_room",
            "coordination_ring",
            "a",
            "b",
            "c",
            "d",
            "e",
        ];
        let cases = [
            ("halway", "; did you mean `hallway` or `hallway-2`?"),
            ("HALLWAY", "; did you mean `hallway` or `hallway-2`?"),
            ("cramped", "; did you mean `cramped_room`?"),
            ("cramped_room.pos", "; did you mean `cramped_room`?"),
            ("coordination_rign", "; did you mean `coordination_ring`?"),
            ("kitchen", ""),
            ("hall", "; did you mean `hallway` or `hallway-2`?"),
            ("", ""),
        ];
        for (name, expected) in cases {
            assert_eq!(hint(name, known), expected, "{name}");
        }
        let trials = ["trial-1", "trial-2", "trial-3", "trial-4"];
        assert_eq!(
            hint("trial", trials),
            "; did you mean `trial-1`, `trial-2` or `trial-3`?"
        );
        assert_eq!(hint("x", ["a", "b"]), "; known: `a`, `b`");
        assert_eq!(hint("x", []), "");
        assert_eq!(
            hint(&"x".repeat(1_000_000), ["a", "b"]),
            "; known: `a`, `b`"
        );
    }
}
