//! Bayesian inference of dependence between two agents' actions: Bayes factors, posteriors and
//! credible intervals of mutual information, and verdicts by a rule. What counts can support; pure,
//! nothing here counts, reads or asks a network.
//!
//! # What the words mean
//!
//! Plug-in mutual information of a rarely seen state is mostly chance: of six actions played at
//! random by either side, nearly every state seen eight times shows more than half a nat. So a
//! state is weighed against all others of its environment. A [`Fitter`] learns how many of them
//! show any dependence, and how differently the other then behaves after different ego actions; a
//! [`Prior`] made of its [`Fit`] answers for one state:
//!
//! | figure | question it answers |
//! |---|---|
//! | [`Posterior::dependent`] | How sure is it that the other's action depends on the ego's at all, however weakly? |
//! | [`Posterior::above`] | How sure is it that this is stronger than a threshold? |
//! | [`Posterior::mean`], [`Posterior::interval`] | How strong is it, and between which bounds nine times in ten? |
//! | [`dependence`] | Is the first question settled, by the counts and not by the prior? |
//! | [`decide`] | Is the second? `influences`, `no_influence`, or `undecided`: see more, or ask a model |
//! | [`bayes_factors`] | The same, where it was known beforehand what to expect? |
//! | [`Prior::by_action`] | Which of the ego's actions does it, and what does the other then do? |
//! | [`Prior::visits_to_decide`] | How much more must be seen until there is a verdict? |
//! | [`RegionPosterior`] | And on the whole, over many states? |
//! | [`Prior::information_gain`] | Which action tells most when it is tried next? |
//!
//! Dependence can be established and yet be too weak for `influences`; both are told.
//!
//! # When not to believe them
//!
//! * **The same tick has no direction.** Both actions are of one moment: that one answers the other
//!   is the caller's knowledge, not a finding.
//! * **A common cause looks like influence.** If both agents see a light that the state does not
//!   hold, their actions depend on each other. Conditioning on a third agent's action of the same
//!   tick can even create dependence where there was none.
//! * **A stay is not a draw.** Agents that hold an action for a second are counted ten times a
//!   second; the evidence takes every count for a new decision and grows far too sure. Counting
//!   entries only avoids it.
//! * **Habits hide power.** The figures are about what the ego does, not about what it could do: an
//!   ego that always turns left shows no influence, whatever its turning would cause. Actions that
//!   were never tried have the environment's figures.
//! * **One fit for one environment.** States are taken for samples of one kind, and rows for
//!   samples of one family. In large alphabets with few visits for each pair of actions what is
//!   believed is mostly the family's: it is held uncertain by a quarter, which is not always enough
//!   (64 x 64 partial copying alike in all states, 1,000 visits: intervals hold the truth 12 times
//!   in 50).
//! * **A segment may be a common cause.** Habits that differ by segment are told from dependence as
//!   long as those of both agents differ by themselves. Where they go together over dozens of
//!   segments (good teams, say, in which both act otherwise), that is dependence, of the segment's
//!   making.
//!
//! # How
//!
//! A spike-and-slab prior (Mitchell & Beauchamp 1988), fitted by empirical Bayes, and Bayes factors
//! of Dirichlet-multinomials: with probability 1 - pi all rows of a state's table share one
//! response (the null, the spike); else some rows have their own (a slab). pi and the weights of
//! all components are fitted over the states by EM:
//!
//! * **Slabs** (`parameters`). Each row is drawn towards a base with concentration k, from nearly
//!   deterministic rows to ones that can hardly be told from the null; or a single row, tried or
//!   not, deviates from all others (`deviants`). Bases are the responder's overall behaviour in the
//!   environment, the uniform one, and the state's own marginal, around which alone rows are sought
//!   that hardly differ; what is not known of that marginal counts (`likelihood`).
//! * **Both ways to read a table** (`side`): columns that respond to rows, and rows that respond to
//!   columns, are components of one mixture, so that the order of the agents in the schema changes
//!   nothing, to the bit.
//! * **Habits** (`habits`). The driver's policy in a state is weighed against its mean policy in
//!   the environment, with a fitted concentration. Actions that nobody uses have no weight, and
//!   mutual information cannot exceed what the used ones allow.
//! * **Segments** (`segments`). Where a state was seen in several segments, every hypothesis has a
//!   twin that is cut by segment: habits may differ from one to the other, dependence may be of
//!   each segment's own kind, or be there in one of them alone. Mutual information is that within
//!   segments.
//! * **Weights** (`weights`). The posterior probabilities of the hypotheses; those that are light
//!   together are taken together.
//! * **Moments** (`moments`, `freedom`). Under a slab mutual information has a mean and a variance
//!   in closed form, to which a Beta distribution is matched; `draws` samples the same exactly, for
//!   what has no formula, for states never seen, and to check the formulas.
//! * **What the table says by itself** (`asymptotic`). Where a state was seen as often as there are
//!   pairs of actions, its bias-corrected plug-in widens the interval, and the posterior mean stays
//!   within it: slabs that do not fit would be certain of something slightly wrong. Where it was
//!   seen less, in large alphabets, what slabs say is doubted by up to a quarter.
//! * **Regions** (`region`). Mean mutual information over many states: the region's own share of
//!   dependent ones is learnt from theirs.
//! * **Policies** (`under_policy`). What mutual information would be had the ego other habits.
//! * **Expectations** (`expected_response`). Where a network said beforehand what both agents do,
//!   its responses stand in the place of the bases.
//! * **More data** (`sample_size`). After how many more visits there will be a verdict.
//! * **Verdicts earned by the counts** (`decision`): by posterior odds, and how far they moved.
//!
//! A table of one occupied row or column fits all hypotheses alike and leaves pi.
//!
//! # Absent on purpose
//!
//! No clock, and no randomness but what the counts themselves seed: the same counts and fit give
//! the same bits. No visits-or-entries choice: the caller says which tables are the evidence.

mod asymptotic;
mod base;
mod beta;
mod by_action;
mod counted;
mod cut;
mod decision;
mod deviants;
mod draws;
mod expected_response;
mod fit;
mod freedom;
mod habits;
mod increments;
mod likelihood;
mod log_space;
mod margins;
mod moments;
mod parameters;
mod parts_evidence;
mod posterior;
mod predicted;
mod prior;
mod readings;
mod region;
mod region_decision;
mod sample_size;
mod segments;
mod side;
mod state;
mod under_policy;
mod weights;
mod within;

pub use base::Base;
pub use by_action::ActionPosterior;
pub use counted::{Counted, Ego};
pub use decision::{Beliefs, Believed, basis, decide, dependence, is_explained, is_opened};
pub use expected_response::{ExpectedResponse, ExpectedState, bayes_factors};
pub use fit::{Fit, Fitter};
pub use habits::{Habits, Uses};
pub use likelihood::rows_evidence;
pub use parameters::{Parameters, SideParameters};
pub use posterior::{BySegment, Posterior};
pub use prior::Prior;
pub use region::{RegionPosterior, RegionState, RegionStates};
pub use region_decision::{decide_region, dependence_in_region};
pub use under_policy::{PolicyBelief, PolicyPosterior};

/// The largest alphabet of either variable that posteriors are for: their tables hold every letter
/// of the columns.
pub const MOST_LETTERS: u64 = crate::domain::MOST_ACTIONS;

/// The most pairs of actions that figures by action and of futures are for: they look at every one
/// of them many times.
pub const MOST_CELLS: u64 = 4_096;

#[cfg(test)]
mod tests;
