"""Trains scikit-learn's perceptron on the transitions of `cargo bench --bench model`, one thread: seconds, and what it says of unseen states.

    python3 -m venv v; v/bin/pip install numpy scikit-learn
    NUDGE_PYTHON=$PWD/v/bin/python cargo bench --bench model -- training

`python model_yardsticks.py DIRECTORY`, DIRECTORY with two files of little-endian numbers: `learned`, a row of uint32 for each transition (bins of the
state, both actions), and `held_out`, a row of float64 for each unseen state (bins, then the true probability of every pair of actions). 64 rectified
linear units, a class for each pair of actions, as scikit-learn would have it used. Prints a line for each way of stopping: its name with the
version, seconds, and what it says of the unseen states, all probabilities in order with spaces between; tabs between the three.
"""

import os

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import sys
import warnings
from pathlib import Path
from time import perf_counter

import numpy
import sklearn
from sklearn.exceptions import ConvergenceWarning
from sklearn.neural_network import MLPClassifier
from sklearn.preprocessing import OneHotEncoder

STATE, ACTIONS = 4, 6
PATIENCE = 10


def perceptron(**more):
    return MLPClassifier(hidden_layer_sizes=(64,), activation="relu", random_state=1, **more)


def main():
    directory = Path(sys.argv[1])
    learned = numpy.fromfile(directory / "learned", dtype="<u4").reshape(-1, STATE + 2)
    held_out = numpy.fromfile(directory / "held_out", dtype="<f8").reshape(-1, STATE + ACTIONS**2)
    encoder = OneHotEncoder(sparse_output=False, dtype=numpy.float32).fit(learned[:, :STATE])
    inputs, classes = encoder.transform(learned[:, :STATE]), learned[:, STATE] * ACTIONS + learned[:, STATE + 1]
    unseen, truth = encoder.transform(held_out[:, :STATE].astype(numpy.uint32)), held_out[:, STATE:]
    assert set(classes) == set(range(ACTIONS**2)), "a pair of actions was never drawn"
    warnings.simplefilter("ignore", ConvergenceWarning)

    def loss(network):
        return -(truth * numpy.log(network.predict_proba(unseen))).sum(axis=1).mean()

    def tell(how, seconds, said):
        said = " ".join(f"{p:.9g}" for p in said.ravel())
        print(f"scikit-learn {sklearn.__version__} MLPClassifier, {how}", f"{seconds:.3f}", said, sep="\t", flush=True)

    def fit(how, network):
        started = perf_counter()
        network.fit(inputs, classes)
        tell(how, perf_counter() - started, network.predict_proba(unseen))

    fit("early stopping", perceptron(early_stopping=True))
    fit("as it comes", perceptron())

    # What it could be at best, did it know the unseen states: stopped where it does best on them.
    network, seconds, epoch, best = perceptron(), 0.0, 0, (numpy.inf, 0, 0.0, None)
    while epoch - best[1] < PATIENCE:
        epoch += 1
        started = perf_counter()
        network.partial_fit(inputs, classes, classes=range(ACTIONS**2))
        seconds += perf_counter() - started
        if (now := loss(network)) < best[0]:
            best = now, epoch, seconds, network.predict_proba(unseen)
    tell("stopped where it does best on the unseen states", *best[2:])


if __name__ == "__main__":
    main()
