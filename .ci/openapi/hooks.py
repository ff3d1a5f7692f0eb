"""What an OpenAPI document cannot say, for schemathesis: how lines are written, which names exist, and which refusals depend on what is stored."""

import json
import pathlib
import re

import schemathesis
from schemathesis.core import NotSet
from schemathesis.core.parameters import ParameterLocation

# It exists and has counts, so that what is asked of it gets as far as the question.
KNOWN = "crossing"
DESCRIPTION = pathlib.Path(__file__).parents[2] / "examples/crossing.json"
ENVIRONMENT = "/v1/environments/{environment}"

# Where a value of the right form can be wrong all the same: for what is stored, or for what stands beside it.
FEATURE = r"/(state|agents/\d+/action|outcomes/\d+/value)/\d+"
OPEN = re.compile("|".join([
    # Agents, lags, segments, states, pages and versions that do not exist there.
    r"/(ego|other|given|segments|keys|states|state)(/.*)?|/state\..*|/(key|page_token|model|producer|lag)",
    # What a region names, and which bins and ranges its features have.
    r"/regions?(/.*)?|/region\..*",
    # Which features a grain keeps, and that states have none.
    r"/features(/\d+)?",
    # Whose habits weigh: segments that are there, with labels that are printable.
    r"/policy([./]segments(/\d+)?)?|/rule[./]exploration(/\d+)?",
    # Derived features are of features that are there, and of some kinds alone.
    r"/derived(/.*)?",
    # Which characters are printable is for Unicode to say.
    r"/segment",
    # A threshold and a share exclude each other, and neither can be above what the two agents can reach.
    r"/rule[./](threshold|share)",
    # Names and labels are unique, edges increase, a feature is of one kind, and all of it together has a size.
    FEATURE + r"(/name|/unit|/continuous/edges(/\d+)?|/integer(/min|/max)?|/categorical/labels(/\d+)?|/circular/values)?",
    r"/agents(/\d+/name|/\d+/action)?|/state",
    # An outcome is an agent's action or a value of its own; those of lags have the names of agents.
    r"/outcomes(/\d+(/name|/agent|/lag|/value)?)?|/lags(/\d+)?",
    # What a service told of another environment.
    r"/name|/schema_hash",
    # Discoveries by a method need a rate.
    r"/method|/fdr",
    # What is asked of states alone.
    r"/estimators|/significance|/visits_to_decide",
    # Members are at most the folds.
    r"/members|/folds",
]))


@schemathesis.serializer("application/x-ndjson", "application/ndjson", "application/jsonl")
def lines(context, value):
    """Writes a transition a line; the document describes one line."""
    return value if isinstance(value, bytes) else (json.dumps(value) + "\n").encode()


@schemathesis.hook
def before_call(context, case, kwargs):
    """Asks most of what is asked of an environment that exists, and keeps that one."""
    path = case.path_parameters or {}
    is_whole = case.path == ENVIRONMENT and case.method != "GET"
    if is_whole and path.get("environment") == KNOWN:
        path["environment"] = "another"
    if case.meta is None:
        return
    # What is wrong with a request stays wrong. A body that may be absent is not wrong where it is.
    is_path_wrong = case.meta.is_negative_at(ParameterLocation.PATH)
    is_body_wrong = case.meta.is_negative_at(ParameterLocation.BODY) and not isinstance(case.body, NotSet)
    is_rest_wrong = is_body_wrong or case.meta.is_negative_at(ParameterLocation.QUERY)
    is_free = "environment" in path and not is_path_wrong and (is_rest_wrong or is_positive(case))
    if is_free and not is_whole and not is_stateful(case):
        path["environment"] = KNOWN
    if "environment" in path and not (is_positive(case) or is_path_wrong or is_rest_wrong):
        # Called wrong, and nothing is wrong with it: some draws are.
        path["environment"] = "nowhere"
    if is_positive(case):
        case.body = whole(case.body)
        if is_stateful(case) and case.method == "PUT" and case.path == ENVIRONMENT:
            # One that is made nearly always, so that there is something to go on with.
            case.body = json.loads(DESCRIPTION.read_text())
        if case.path.endswith("/transitions"):
            case.query = beside(case)


def is_stateful(case):
    return case.meta.phase.name.value == "stateful"


def is_positive(case):
    return case.meta is not None and case.meta.generation.mode.is_positive


def whole(value):
    """Writes whole numbers as such: JSON Schema takes 8.0 for one, the service takes it for a number that is measured."""
    if isinstance(value, dict):
        return {name: whole(member) for name, member in value.items()}
    if isinstance(value, list):
        return [whole(member) for member in value]
    return int(value) if isinstance(value, float) and value.is_integer() else value


def beside(case):
    """Returns the parameters beside a batch: lines need a producer and a number, a document has them within."""
    if "json" in case.media_type and "jsonl" not in case.media_type and "ndjson" not in case.media_type:
        return {}
    return {"producer": "schemathesis", "sequence": 1} | {name: value for name, value in (case.query or {}).items() if value}


@schemathesis.check
def refused_for_what_is_stored(context, response, case):
    """Fails where a request that is right by the document is refused for a value that nothing but its form can make wrong."""
    if not is_positive(case) or response.status_code != 400 or case.media_type == "application/octet-stream":
        return
    pointers = [error["pointer"] for error in response.json()["errors"]]
    wrong = [pointer for pointer in pointers if not OPEN.fullmatch(pointer)]
    assert pointers and not wrong, f"the document allows what is refused at {wrong or 'no place'}: {response.text[:600]}"


@schemathesis.check
def busy_for_a_reason(context, response, case):
    """Fails where the service is busy with anything but trainings, of which only so many wait."""
    if response.status_code == 503:
        assert response.json()["reason"] == "TOO_MANY_TRAININGS", response.text


@schemathesis.check
def wrong_transitions_are_not_counted(context, response, case):
    """Fails where a batch that is wrong by the document is counted: each transition is judged by itself, and the receipt says so."""
    if case.path.endswith("/transitions") and not is_positive(case) and response.status_code == 200:
        receipt = response.json()
        assert receipt["status"] == "duplicate" or receipt["rejected_count"] > 0, response.text


@schemathesis.check
def only_no_body_is_right(context, response, case):
    """Fails where a training is asked for by a body that is wrong by the document."""
    if case.path.endswith("/models") and not is_positive(case) and response.status_code == 202:
        assert isinstance(case.body, NotSet), f"a training was asked for by {case.body}"
