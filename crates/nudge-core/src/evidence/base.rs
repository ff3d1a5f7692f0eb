//! Base distributions of Dirichlet priors: what the other does in an environment on the whole.

/// The base distribution g of Dirichlet priors: that of the column variable over a whole
/// environment, from its counts and half a visit more of each letter (Jeffreys's prior).
#[derive(Debug, Clone, PartialEq)]
pub struct Base {
    counts: Vec<u64>,
    shares: Vec<f64>,
}

impl Base {
    /// Returns the base distribution of these counts, one a letter, over all states.
    pub fn new(counts: &[u64]) -> Self {
        let smoothed = || counts.iter().map(|count| *count as f64 + 0.5);
        let total: f64 = smoothed().sum();
        Self {
            counts: counts.to_vec(),
            shares: smoothed().map(|count| count / total).collect(),
        }
    }

    /// Returns the counts it was made of.
    pub fn counts(&self) -> &[u64] {
        &self.counts
    }

    /// Returns the share of each letter, above 0.
    pub fn shares(&self) -> &[f64] {
        &self.shares
    }
}

/// Letters that have the same share of a base.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Alike {
    /// m_j.
    pub share: f64,
    /// How many.
    pub letters: f64,
}

/// The letters of a base by their shares: most letters of a large alphabet are as rare as many
/// others.
pub(super) struct Groups {
    groups: Vec<Alike>,
    /// The group of each letter.
    group_of: Vec<u32>,
}

impl Groups {
    /// Groups the letters of a base.
    pub fn new(shares: &[f64]) -> Self {
        let mut distinct = shares.to_vec();
        distinct.sort_by(f64::total_cmp);
        distinct.dedup();

        let mut groups: Vec<Alike> = distinct
            .iter()
            .map(|share| Alike {
                share: *share,
                letters: 0.0,
            })
            .collect();

        let group = |share: &f64| distinct.partition_point(|other| other < share) as u32;
        let group_of: Vec<u32> = shares.iter().map(group).collect();
        group_of
            .iter()
            .for_each(|group| groups[*group as usize].letters += 1.0);

        Self { groups, group_of }
    }

    /// Returns the letters but for these.
    pub fn without(&self, labels: &[u64]) -> Vec<Alike> {
        let mut left = self.groups.clone();
        labels
            .iter()
            .for_each(|label| left[self.group_of[*label as usize] as usize].letters -= 1.0);
        left.retain(|group| group.letters > 0.0);
        left
    }
}
