"""A world where it is known when the human answers the robot, and a network trained on it: what every inference client is tried on.

Needs the standard library only, so that it runs beside any client.
"""

import json
import random
import time
import urllib.request

ENVIRONMENT = "world"
MODEL = "world~robot~human"
OUTPUTS = ["influence_probability", "mutual_information"]
PLACES = 40
# Places below this are those where the human mostly does what the robot does.
DEPENDENT = 20
LONGEST_TRAINING_SECONDS = 120


def prepare(url):
    """Makes the world, plays in it and trains a network, which is active afterwards."""
    path = f"{url}/v1/environments/{ENVIRONMENT}"
    call("PUT", path, _description())
    receipt = call("POST", f"{path}/transitions", {"producer": "clients", "sequence": 1, "transitions": _transitions()})
    check(receipt["rejected_count"] == 0, f"{receipt['accepted']} transitions are counted")
    options = {"width": 16, "members": 2, "folds": 2, "epochs": 100, "activate": True}
    job = call("POST", f"{path}/models", options)
    deadline = time.monotonic() + LONGEST_TRAINING_SECONDS
    while job["state"] in ("queued", "running"):
        check(time.monotonic() < deadline, None, f"the training did not end: {job}")
        time.sleep(0.1)
        job = call("GET", f"{path}/models/{job['id']}")
    check(job["state"] == "done", f"a network is trained: version {job.get('version')}", job)


def rows(number):
    """Returns so many states, row by row: every place with either light, again and again."""
    return [[float(i % PLACES), float(i // PLACES % 2)] for i in range(number)]


def tells_them_apart(probabilities):
    """Checks that a probability for each of `rows` is higher, on average, where the human does answer."""
    mean = lambda values: sum(values) / len(values)
    places = [i % PLACES for i in range(len(probabilities))]
    dependent = mean([p for p, place in zip(probabilities, places) if place < DEPENDENT])
    others = mean([p for p, place in zip(probabilities, places) if place >= DEPENDENT])
    check(dependent > others, f"influence is more probable where there is some: {dependent:.2f}, elsewhere {others:.2f}")


def check(holds, told, found=None):
    """Says that something holds, or ends the script."""
    if not holds:
        raise SystemExit(f"failed: {told or 'a check'}" + ("" if found is None else f": {found}"))
    if told:
        print(f"ok: {told}", flush=True)


def refused(what, word, ask, *errors):
    """Checks that `ask` fails with one of `errors`, whose text has `word` in it."""
    try:
        answer = ask()
    except errors as error:
        check(word in str(error), f"{what} is refused", str(error))
    else:
        check(False, f"{what} is refused", answer)


def call(method, url, body=None):
    """Calls the service's own REST face."""
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(url, data, {"content-type": "application/json"}, method=method)
    with urllib.request.urlopen(request, timeout=30) as response:
        return json.load(response)


def _description():
    agent = lambda name: {"name": name, "action": [{"name": "move", "integer": {"min": 0, "max": 2}}]}
    return {
        "state": [
            {"name": "place", "integer": {"min": 0, "max": PLACES - 1}},
            {"name": "light", "categorical": {"labels": ["red", "green"]}},
        ],
        "agents": [agent("robot"), agent("human")],
    }


def _transitions():
    dice = random.Random(1)

    def transition(i):
        place, robot = i % PLACES, dice.randrange(3)
        copies = place < DEPENDENT and dice.random() < 0.9
        human = robot if copies else dice.randrange(3)
        return {"state": {"place": place, "light": i // PLACES % 2}, "actions": {"robot": robot, "human": human}}

    return [transition(i) for i in range(8_000)]
