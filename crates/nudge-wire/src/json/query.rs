//! Questions as a query string asks them. Nothing in a query string has a type, so numbers and
//! labels are told apart by the features they are for.

use nudge_core::domain::RuleDraft;
use nudge_core::domain::draft::{
    DiscoveryDraft, ExplorationDraft, ListingDraft, PairDraft, PolicyDraft, ProfileDraft,
    QuestionDraft, RegionDraft, RegionSearchDraft, StatesDraft, SummaryDraft,
};
use nudge_core::error::Problem;

use super::{Head, Parameters};

impl Parameters {
    fn pair(&mut self) -> PairDraft {
        PairDraft {
            ego: self.text("ego"),
            other: self.text("other"),
            lag: self.lag(),
            given: self.list("given"),
            segments: self.list("segments"),
            within: self.text("within"),
            policy: self.policy(),
            rule: self.rule(),
            unit: self.text("unit"),
        }
    }

    fn policy(&mut self) -> Option<PolicyDraft> {
        let (word, segments) = (self.text("policy"), self.list("policy.segments"));
        if word.is_some() && !segments.is_empty() {
            self.fault("policy.segments", "got policy too, expected one of them");
        }
        match segments.is_empty() {
            true => word.map(PolicyDraft::Word),
            false => Some(PolicyDraft::Segments(segments)),
        }
    }

    fn lag(&mut self) -> i64 {
        self.number("lag", "a whole number of steps").unwrap_or(0)
    }

    fn rule(&mut self) -> RuleDraft {
        RuleDraft {
            kind: self.text("rule.kind"),
            threshold: self.number("rule.threshold", "a number"),
            share: self.number("rule.share", "a number"),
            unit: self.text("rule.unit"),
            min_visits: self.whole("rule.min_visits"),
            confidence: self.number("rule.confidence", "a number"),
            estimators: None,
            exploration: None,
        }
    }

    fn discovery(&mut self) -> DiscoveryDraft {
        DiscoveryDraft {
            fdr: self.number("fdr", "a number"),
            method: self.text("method"),
        }
    }

    fn region(&mut self) -> RegionDraft {
        let written = self.texts_under("region.").into_iter();
        let words: Vec<String> = written
            .map(|(name, value)| format!("{name}={value}"))
            .collect();
        RegionDraft::of_words(&words).unwrap_or_else(|faults| {
            for fault in faults {
                let name = fault.pointer.trim_start_matches('/');
                self.fault(&format!("region.{name}"), fault.detail.clone());
            }
            RegionDraft::default()
        })
    }

    fn state_or_region(&mut self) -> StatesDraft {
        let everywhere = self.take("region");
        if let Some(wrong) = everywhere
            .iter()
            .find(|text| !matches!(&text[..], "" | "{}"))
        {
            let detail = format!("got {wrong:?}, expected {{}}; a condition is region.NAME=VALUES");
            self.fault("region", detail);
        }
        let region = self.region();
        let states = self.state_or_key();
        if everywhere.is_empty() && region == RegionDraft::default() {
            return states;
        }
        if !states.is_empty() {
            self.fault("region", "got a state too, expected one of them");
        }
        StatesDraft::Region(region)
    }

    fn state_or_key(&mut self) -> StatesDraft {
        let named = self.under("state.");
        let keys: Vec<String> = self.text("key").into_iter().collect();
        match (named.is_empty(), keys.is_empty()) {
            (true, _) => StatesDraft::Keys(keys),
            (false, true) => StatesDraft::Named(vec![named]),
            (false, false) => {
                self.fault("key", "got values of the state too, expected one of them");
                StatesDraft::default()
            }
        }
    }
}

/// Reads a question about one state, or about one region by a parameter `region.NAME` a condition or
/// `region={}` for all states.
pub fn question_of_query(mut query: Parameters) -> Result<QuestionDraft, Problem> {
    let draft = QuestionDraft {
        pair: query.pair(),
        states: query.state_or_region(),
        features: query.list("features"),
        estimators: query.list("estimators"),
        view: query.text("view"),
        significance: query.text("significance"),
        visits_to_decide: query
            .number("visits_to_decide", "true or false")
            .unwrap_or(false),
    };
    query.finish(draft)
}

/// Reads a question for a page of states.
pub fn listing(mut query: Parameters) -> Result<ListingDraft, Problem> {
    let draft = ListingDraft {
        pair: query.pair(),
        order_by: query.text("order_by"),
        min_visits: query.whole("min_visits").unwrap_or(0),
        verdict: query.text("verdict"),
        discovery: query.discovery(),
        page_size: query.whole("page_size").unwrap_or(0),
        page_token: query.text("page_token"),
    };
    query.finish(draft)
}

/// Reads whose influence on whom is to be summed up, and which discoveries are counted.
pub fn summary(mut query: Parameters) -> Result<SummaryDraft, Problem> {
    let draft = SummaryDraft {
        pair: query.pair(),
        discovery: query.discovery(),
        omit_segments: query
            .number("omit_segments", "true or false")
            .unwrap_or(false),
    };
    query.finish(draft)
}

/// Reads which state a graph is wanted of, from which counts and by which rule.
pub fn graph(mut query: Parameters) -> Result<QuestionDraft, Problem> {
    let pair = PairDraft {
        lag: query.lag(),
        segments: query.list("segments"),
        within: query.text("within"),
        rule: query.rule(),
        unit: query.text("unit"),
        ..PairDraft::default()
    };
    let draft = QuestionDraft {
        pair,
        states: query.state_or_key(),
        ..QuestionDraft::default()
    };
    query.finish(draft)
}

/// Reads whose profile is wanted, of the whole environment or of a region by a parameter
/// `region.NAME` a condition, as it is written on a command line.
pub fn profile(mut query: Parameters) -> Result<ProfileDraft, Problem> {
    let pair = PairDraft {
        ego: query.text("ego"),
        other: query.text("other"),
        given: query.list("given"),
        segments: query.list("segments"),
        within: query.text("within"),
        unit: query.text("unit"),
        ..PairDraft::default()
    };
    let draft = ProfileDraft {
        pair,
        region: query.region(),
        lags: query.numbers("lags", "a whole number of steps"),
    };
    query.finish(draft)
}

/// Reads in which regions a pair is looked at for dependence: of the whole environment, or within a
/// region by a parameter `region.NAME` a condition.
pub fn region_search(mut query: Parameters) -> Result<RegionSearchDraft, Problem> {
    let pair = PairDraft {
        ego: query.text("ego"),
        other: query.text("other"),
        lag: query.lag(),
        given: query.list("given"),
        segments: query.list("segments"),
        within: query.text("within"),
        unit: query.text("unit"),
        ..PairDraft::default()
    };
    let draft = RegionSearchDraft {
        pair,
        region: query.region(),
        most: query.whole("most").unwrap_or(0),
        fdr: query.number("fdr", "a number"),
    };
    query.finish(draft)
}

/// Reads which prior is to be fitted; `None` for those of every pair.
pub fn fit(mut query: Parameters) -> Result<Option<PairDraft>, Problem> {
    let pair = PairDraft {
        ego: query.text("ego"),
        other: query.text("other"),
        lag: query.lag(),
        given: query.list("given"),
        ..PairDraft::default()
    };
    query.finish(Some(pair).filter(|pair| *pair != PairDraft::default()))
}

/// Reads where somebody wants to look for what to try.
pub fn exploration(mut query: Parameters) -> Result<ExplorationDraft, Problem> {
    let draft = ExplorationDraft {
        pair: query.pair(),
        min_visits: query.whole("min_visits").unwrap_or(0),
        limit: query.whole("limit").unwrap_or(0),
    };
    query.finish(draft)
}

/// Reads which page is asked for: its size, 0 for the default, and its token.
pub fn page(mut query: Parameters) -> Result<(u64, Option<String>), Problem> {
    let page = (
        query.whole("page_size").unwrap_or(0),
        query.text("page_token"),
    );
    query.finish(page)
}

/// Refuses what stands beside the lines of a batch where the batch is a document, in which it has
/// its place.
pub fn no_head(mut query: Parameters) -> Result<(), Problem> {
    let why = "belongs to a body of `application/x-ndjson`; in `application/json` it is a member of the document";
    ["producer", "sequence", "segment", "environment_uid"]
        .into_iter()
        .for_each(|name| query.misplaced(name, why));
    query.finish(())
}

/// Reads what stands beside the transitions of a batch.
pub fn head_of_query(mut query: Parameters) -> Result<Head, Problem> {
    let producer = query.text("producer");
    let producer = query.required("producer", producer).unwrap_or_default();
    let sequence = query.whole("sequence");
    let sequence = query.required("sequence", sequence).unwrap_or_default();
    let (environment_uid, segment) = (query.text("environment_uid"), query.text("segment"));

    query.finish(Head {
        producer,
        environment_uid,
        sequence,
        segment,
    })
}

#[cfg(test)]
mod tests {
    use nudge_core::domain::draft::ValueDraft;

    use super::*;

    fn parameters(pairs: &[(&str, &str)]) -> Parameters {
        Parameters::new(
            pairs
                .iter()
                .map(|(name, value)| ((*name).to_owned(), (*value).to_owned()))
                .collect(),
        )
    }

    fn pointers(problem: Problem) -> Vec<String> {
        problem
            .faults
            .into_iter()
            .map(|fault| fault.pointer)
            .collect()
    }

    #[test]
    fn everything_can_be_asked() {
        let query = parameters(&[
            ("ego", "robot"),
            ("other", ""),
            ("lag", "3"),
            ("given", "cook,waiter"),
            ("given", "guest"),
            ("segments", "train"),
            ("within", "segments"),
            ("rule.share", "0.25"),
            ("rule.min_visits", "3"),
            ("unit", "bits"),
            ("estimators", "excess,miller_madow"),
            ("view", "figures"),
            ("state.distance", "1.2"),
            ("state.held", "左"),
        ]);
        let draft = question_of_query(query).expect("valid");
        assert_eq!(
            (draft.pair.ego.as_deref(), draft.pair.other),
            (Some("robot"), None)
        );
        assert_eq!(draft.pair.lag, 3);
        assert_eq!(draft.pair.given, ["cook", "waiter", "guest"]);
        assert_eq!(
            (draft.pair.segments, draft.pair.within.as_deref()),
            (vec!["train".into()], Some("segments"))
        );
        assert_eq!(
            (draft.pair.rule.share, draft.pair.rule.min_visits),
            (Some(0.25), Some(3))
        );
        assert_eq!(
            (draft.pair.unit.as_deref(), draft.view.as_deref()),
            (Some("bits"), Some("figures"))
        );
        assert_eq!(draft.estimators, ["excess", "miller_madow"]);
        let value = |name: &str, text: &str| (name.to_owned(), ValueDraft::Text(text.into()));
        assert_eq!(
            draft.states,
            StatesDraft::Named(vec![vec![value("distance", "1.2"), value("held", "左")]])
        );
    }

    #[test]
    fn every_fault_is_listed_by_name() {
        let query = parameters(&[
            ("egg", "robot"),
            ("unit", "nats"),
            ("unit", "bits"),
            ("lag", "1.5"),
            ("rule.threshold", "high"),
            ("rule.min_visits", "-1"),
            ("key", "1.2"),
            ("state.x", "1"),
            ("a/b", ""),
        ]);
        let expected = [
            "/lag",
            "/rule.threshold",
            "/rule.min_visits",
            "/unit",
            "/key",
            "/egg",
            "/a~1b",
        ];
        assert_eq!(
            pointers(question_of_query(query).expect_err("wrong")),
            expected
        );
    }

    #[test]
    fn a_state_may_be_named_by_its_key() {
        let draft = question_of_query(parameters(&[("key", "3.0.7")])).expect("valid");
        assert_eq!(draft.states, StatesDraft::Keys(vec!["3.0.7".into()]));
    }

    #[test]
    fn pages_are_asked_for() {
        let query = parameters(&[
            ("order_by", "visits desc"),
            ("min_visits", "8"),
            ("page_size", "5"),
        ]);
        let draft = listing(query).expect("valid");
        assert_eq!(
            (draft.order_by.as_deref(), draft.min_visits, draft.page_size),
            (Some("visits desc"), 8, 5)
        );
        assert_eq!(
            page(parameters(&[("page_token", "x")])).expect("valid"),
            (0, Some("x".into()))
        );
        assert_eq!(
            pointers(page(parameters(&[("page_size", "many")])).expect_err("wrong")),
            ["/page_size"]
        );
    }

    #[test]
    fn what_was_meant_is_told() {
        let detail = |problem: Problem| {
            problem
                .faults
                .into_iter()
                .map(|fault| fault.detail)
                .collect::<Vec<_>>()
        };
        let unknown = |pair| {
            detail(question_of_query(parameters(&[("key", "0"), pair])).expect_err("unknown"))
                .remove(0)
        };
        for (mistyped, meant) in [
            ("stat.q", "state.q"),
            ("sate.distance", "state.distance"),
            ("vieww", "view"),
        ] {
            assert_eq!(
                unknown((mistyped, "1")),
                format!("unknown parameter; did you mean `{meant}`?")
            );
        }
        assert_eq!(
            detail(parameters(&[("foo", "1")]).finish(()).expect_err("unknown")),
            ["unknown parameter; there is none on this path"]
        );
        let lines = detail(
            head_of_query(parameters(&[
                ("producr", "a"),
                ("producer", "a"),
                ("sequence", "1"),
            ]))
            .expect_err("unknown"),
        );
        assert_eq!(lines, ["unknown parameter; did you mean `producer`?"]);
        let document = detail(
            no_head(parameters(&[
                ("producr", "a"),
                ("sequence", ""),
                ("segment", "s"),
            ]))
            .expect_err("misplaced"),
        );
        assert_eq!(document[2], "unknown parameter; did you mean `producer`?");
        assert!(
            document[..2]
                .iter()
                .all(|detail| detail.starts_with("belongs to a body of `application/x-ndjson`"))
        );
    }

    #[test]
    fn lines_need_a_producer_and_a_sequence() {
        assert_eq!(
            pointers(head_of_query(parameters(&[])).expect_err("wrong")),
            ["/producer", "/sequence"]
        );
        let query = parameters(&[("producer", "a"), ("sequence", "one")]);
        assert_eq!(
            pointers(head_of_query(query).expect_err("wrong")),
            ["/sequence"]
        );
        let query = parameters(&[
            ("producer", "a"),
            ("sequence", "1"),
            ("segment", "x"),
            ("environment_uid", "u"),
        ]);
        let (environment_uid, segment) = (Some("u".into()), Some("x".into()));
        let expected = Head {
            producer: "a".into(),
            environment_uid,
            sequence: 1,
            segment,
        };
        assert_eq!(head_of_query(query).expect("valid"), expected);
    }
}
