//! What pedestrians see of their neighbours and do about them, as transitions.
//!
//! At every record each pedestrian is an **ego**, and its closest and second-closest others are its
//! **neighbours**. A pair's state is
//!
//! | value | what |
//! |---|---|
//! | `a_distance`, `a_bearing` | a, from the ego to the neighbour |
//! | `b_distance`, `b_bearing` | b, from the neighbour to the pedestrian closest to it, which may be the ego: so there always is one |
//! | `ego_heading`, `neighbour_heading` | where both walk |
//!
//! and each one's action is its change of heading (`turn`, in (-pi, pi]) and of speed
//! (`speed_change`) until the next record. Distances are in metres, angles in radians in the frame
//! of the world, speeds in m/s. `examples/hallway.json` describes them to a service, bins included.
//!
//! # Which direction means what
//!
//! The force on alpha depends on the step of beta, so *the ego lies in the neighbour's ellipse*
//! means that **the neighbour acts on the ego**, and the reverse that the ego acts on the
//! neighbour. Both labels are for experiments; they are never sent.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::f64::consts::{PI, TAU};

use glam::DVec2;
use kdtree::KdTree;
use kdtree::distance::squared_euclidean;

use super::hallway::Trial;
use super::{Pedestrian, SocialForce, semi_minor_axis};
use nudge_core::domain::{Record, Schema};
use nudge_core::tracks::{Step, Track};

/// The description of the environment whose transitions these are, in JSON.
pub const DESCRIPTION: &str = include_str!("../../../../examples/hallway.json");

/// The semi-minor axis below which somebody lies in an ellipse, in metres: twice the range of the
/// force. The paper gives no size.
pub const ELLIPSE: f64 = 0.6;

/// One ego and one of its neighbours over one record.
#[derive(Debug, Clone, PartialEq)]
pub struct Observation {
    /// Seconds since the trial began.
    pub time: f64,
    /// Who is asked about.
    pub ego: u32,
    /// Its neighbour.
    pub neighbour: u32,
    /// The state of the pair, the actions of both, and whether the pair entered its state.
    pub transition: Record,
    /// Whether the ego lies in the neighbour's ellipse: the neighbour acts on it.
    pub in_neighbours_ellipse: bool,
    /// Whether the neighbour lies in the ego's ellipse: the ego acts on it.
    pub neighbour_in_ellipse: bool,
}

/// Turns records of one trial, given in order, into observations.
#[derive(Debug, Clone)]
pub struct Observer {
    schema: Schema,
    model: SocialForce,
    tracks: BTreeMap<(u32, u32), PairTrack>,
    /// The number of the next record.
    record: u64,
}

/// The steps of one pair, as far as it was observed.
#[derive(Debug, Clone)]
struct PairTrack {
    track: Track,
    /// What is held back, but for the transitions, which the track has.
    held: VecDeque<Observation>,
    /// The record that comes next, if the pair is observed without a gap.
    next: u64,
}

impl PairTrack {
    /// Puts the transitions that were released into the oldest observations that wait for theirs.
    fn released(&mut self, transitions: impl IntoIterator<Item = Record>) -> Vec<Observation> {
        let transitions = transitions.into_iter();
        let released = transitions.zip(std::iter::from_fn(|| self.held.pop_front()));
        released
            .map(|(transition, observation)| Observation {
                transition,
                ..observation
            })
            .collect()
    }
}

impl Observer {
    /// Begins a trial in an environment of that schema, whose values stand as [`DESCRIPTION`] has
    /// them.
    pub fn new(schema: &Schema, model: &SocialForce) -> Self {
        Self {
            schema: schema.clone(),
            model: model.clone(),
            tracks: BTreeMap::new(),
            record: 0,
        }
    }

    /// Returns the observations of one record: of the pedestrians `before`, who are there `after`
    /// it or have left. In order of the egos as they are given, the closest neighbour first; where
    /// either has left there is none. Where the environment has outcomes, each comes as much later
    /// as the greatest lag is.
    ///
    /// A pair enters its state when the discretised state differs from the record before, or when
    /// it was not observed then; see [`nudge_core::tracks::EntryRule`] for which of these count.
    pub fn observe(
        &mut self,
        time: f64,
        before: &[Pedestrian],
        after: &[Pedestrian],
    ) -> Vec<Observation> {
        let after: HashMap<u32, &Pedestrian> = after
            .iter()
            .map(|pedestrian| (pedestrian.id, pedestrian))
            .collect();
        let closest = two_closest(before);

        let mut observations = Vec::new();
        for (i, ego) in before.iter().enumerate() {
            for &j in &closest[i] {
                let neighbour = &before[j];
                let (Some(ego_after), Some(neighbour_after)) =
                    (after.get(&ego.id), after.get(&neighbour.id))
                else {
                    continue;
                };

                let pair = (ego.id, neighbour.id);
                let state = state_features(ego, neighbour, &before[closest[j][0]]);
                let actions = [action(ego, ego_after), action(neighbour, neighbour_after)].concat();
                let observation = Observation {
                    time,
                    ego: ego.id,
                    neighbour: neighbour.id,
                    transition: Record::new(Vec::new(), Vec::new()),
                    in_neighbours_ellipse: self.is_in_ellipse(ego, neighbour),
                    neighbour_in_ellipse: self.is_in_ellipse(neighbour, ego),
                };
                observations.extend(self.step(pair, observation, Step::new(state, actions)));
            }
        }
        self.record += 1;
        observations
    }

    /// Ends the trial, and returns what was held back, pair after pair.
    pub fn end(&mut self) -> Vec<Observation> {
        let mut ended = std::mem::take(&mut self.tracks);
        let released = ended.values_mut().flat_map(|pair| {
            let transitions = pair.track.gap();
            pair.released(transitions)
        });
        released.collect()
    }

    /// Takes the step of a pair that is observed at this record, and returns what it releases.
    fn step(&mut self, pair: (u32, u32), observation: Observation, step: Step) -> Vec<Observation> {
        let record = self.record;
        let pair = self.tracks.entry(pair).or_insert_with(|| PairTrack {
            track: Track::new(&self.schema),
            held: VecDeque::new(),
            next: record,
        });

        let missed = pair.next < record;
        let mut transitions = if missed { pair.track.gap() } else { Vec::new() };
        pair.next = record + 1;
        pair.held.push_back(observation);
        transitions.extend(pair.track.step(step));
        pair.released(transitions)
    }

    /// Returns whether `one` lies in the ellipse around the next step of `other`.
    fn is_in_ellipse(&self, one: &Pedestrian, other: &Pedestrian) -> bool {
        let step = self.model.next_step(other.velocity, other.direction);
        semi_minor_axis(one.position - other.position, step) < ELLIPSE
    }
}

/// A trial's observations, record after record; a record in which nobody was observed is empty.
#[derive(Debug, Clone)]
pub struct Observations {
    trial: Trial,
    observer: Observer,
}

impl Observations {
    /// Observes a trial from where it stands.
    pub fn of_trial(trial: Trial, schema: &Schema) -> Self {
        let observer = Observer::new(schema, &trial.protocol().model);
        Self { trial, observer }
    }
}

impl Iterator for Observations {
    type Item = Vec<Observation>;

    fn next(&mut self) -> Option<Vec<Observation>> {
        if self.trial.is_over() {
            let rest = self.observer.end();
            return (!rest.is_empty()).then_some(rest);
        }
        let (time, before) = (self.trial.time(), self.trial.pedestrians().to_vec());
        self.trial.advance();
        Some(
            self.observer
                .observe(time, &before, self.trial.pedestrians()),
        )
    }
}

/// Returns for each pedestrian the positions in the list of the two closest others, as far as there
/// are two; of those equally far the earlier first.
fn two_closest(pedestrians: &[Pedestrian]) -> Vec<Vec<usize>> {
    const FINITE: &str = "pedestrians are at finite places";
    let mut index = KdTree::new(2);
    for (i, one) in pedestrians.iter().enumerate() {
        index.add(one.position.to_array(), i).expect(FINITE);
    }

    let closest = |(i, one): (usize, &Pedestrian)| {
        // One of the three closest to a place is who stands there.
        let mut found = index
            .nearest(&one.position.to_array(), 3, &squared_euclidean)
            .expect(FINITE);
        found.sort_by(|(a, i), (b, j)| a.total_cmp(b).then(i.cmp(j)));
        found
            .into_iter()
            .map(|(_, j)| *j)
            .filter(|j| *j != i)
            .take(2)
            .collect()
    };
    pedestrians.iter().enumerate().map(closest).collect()
}

fn state_features(
    ego: &Pedestrian,
    neighbour: &Pedestrian,
    closest_to_neighbour: &Pedestrian,
) -> Vec<f32> {
    let a = neighbour.position - ego.position;
    let b = closest_to_neighbour.position - neighbour.position;
    let values = [
        a.length(),
        a.to_angle(),
        b.length(),
        b.to_angle(),
        heading(ego),
        heading(neighbour),
    ];
    values.map(|value| value as f32).to_vec()
}

fn action(before: &Pedestrian, after: &Pedestrian) -> [f32; 2] {
    let turn = wrapped(heading(after) - heading(before));
    let speed_change = after.velocity.length() - before.velocity.length();
    [turn as f32, speed_change as f32]
}

/// Returns where somebody walks, or would like to while standing.
fn heading(pedestrian: &Pedestrian) -> f64 {
    let Pedestrian {
        velocity,
        direction,
        ..
    } = *pedestrian;
    if velocity == DVec2::ZERO {
        direction.to_angle()
    } else {
        velocity.to_angle()
    }
}

/// Returns the same angle in (-pi, pi].
fn wrapped(angle: f64) -> f64 {
    let turned = angle.rem_euclid(TAU);
    if turned > PI { turned - TAU } else { turned }
}

#[cfg(test)]
mod tests;
