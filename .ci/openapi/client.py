"""A client that openapi-python-client made of the document makes a world, plays in it and asks: `NUDGE_KEY=... client.py URL`."""

import os
import sys

from nudge_client import AuthenticatedClient
from nudge_client.api.environments import apply_environment, get_environment
from nudge_client.api.influence import batch_get_influence, get_influence
from nudge_client.api.transitions import write_transitions
from nudge_client.models import Agent, Answers, Categorical, CategoricalFeature, Description, Environment, Integer, IntegerFeature
from nudge_client.models import Problem, Question, Receipt, Transitions, Unit, Verdict

WORLD = "made-by-a-client"


def main(url):
    client = AuthenticatedClient(base_url=url, token=os.environ["NUDGE_KEY"])
    # Of the classes of the kinds, and of a dictionary: both are a description.
    agent = lambda name: Agent(name=name, action=[IntegerFeature(name="go", integer=Integer(min_=0, max_=1))])
    place = CategoricalFeature(name="place", categorical=Categorical(labels=["here", "there"]))
    description = Description(state=[place], agents=[agent("robot"), agent("human")])
    check(Description.from_dict(description.to_dict()) == description, "a dictionary is the same description", description)
    made = apply_environment.sync(WORLD, client=client, body=description)
    check(isinstance(made, Environment) and made.name == WORLD, "an environment is made", made)

    # Here the human does what the robot does.
    transition = lambda i: {"state": {"place": "here"}, "actions": {"robot": i % 2, "human": i % 2}}
    batch = {"producer": "client", "sequence": 1, "transitions": [transition(i) for i in range(40)]}
    receipt = write_transitions.sync(WORLD, client=client, body=Transitions.from_dict(batch))
    check(isinstance(receipt, Receipt) and receipt.accepted == 40, "a batch is counted", receipt)

    question = Question.from_dict({"states": [{"place": "here"}, {"place": "there"}], "unit": "bits"})
    answers = batch_get_influence.sync(WORLD, client=client, body=question)
    check(isinstance(answers, Answers), "a question is answered", answers)
    here, there = answers.answers
    check(here.verdict is Verdict.INFLUENCES and here.visits == 40 and here.unit is Unit.BITS, "here is influence", here)
    check(there.verdict is Verdict.UNDECIDED and there.visits == 0, "there nothing is known", there)

    told = get_influence.sync(WORLD, client=client, key="0", unit=Unit.BITS)
    check(told.answers[0].verdict is here.verdict, "a query string asks the same", told)

    unknown = get_environment.sync("nowhere", client=client)
    check(isinstance(unknown, Problem) and unknown.status == 404, "an unknown environment is a problem", unknown)


def check(holds, told, found):
    """Says that something holds, or ends the script."""
    if not holds:
        raise SystemExit(f"failed: {told}: {found}")
    print(f"ok: {told}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
