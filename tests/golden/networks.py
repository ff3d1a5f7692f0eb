"""Writes networks_joint.safetensors, networks_direct.safetensors and networks.json: what PyTorch and onnxruntime make of two small ensembles.

Needs `pip install torch numpy safetensors onnx onnxruntime onnxscript` (written with torch 2.15.0, numpy 2.4.6, safetensors 0.8.0, onnx 1.23.2,
onnxruntime 1.32.0 and onnxscript 0.7.2 on Python 3.11). Run beside the files: `python networks.py`. It takes some seconds.

The weights are PyTorch's own beginning under a fixed seed, in a `ModuleList` called `members`, so that the names in the files are those of its
`state_dict`; only what tells of dependence is made four times as large, for else there would be next to none. States become inputs here by the
table in `src/model/encoder.rs`, written down a second time in numpy. Heads are 32-bit; softmax, mutual information and divergences are made of
them in 64 bits, in nats. Before anything is written, onnxruntime's heads are held to PyTorch's.

`python networks.py FILE...` instead loads files that the service exported into the same modules, which fails unless every name and shape fits.
"""

import json
import platform
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path

import numpy
import onnxruntime
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file

SEED, MEMBERS, WIDTH = 20, 2, 8
PRECISION = 1e-6
THRESHOLD = 0.5
BINS = (3, 8, 5, 5)
LABELS, SECTORS, LEAST, EDGES = ["nothing", "onion", "dish"], 8, -2, [0.5, 1.0, 2.0, 4.0]
EGO, OTHER = ["stay", "go", "turn"], 4
INPUTS = 3 + 2 + 1 + 1

ENVIRONMENT = {
    "state": [
        {"name": "held", "categorical": {"labels": LABELS}},
        {"name": "bearing", "circular": {"bins": SECTORS}},
        {"name": "lane", "integer": {"min": LEAST, "max": LEAST + BINS[2] - 1}},
        {"name": "distance", "continuous": {"edges": EDGES}},
    ],
    "agents": [
        {"name": "robot", "action": [{"name": "move", "categorical": {"labels": EGO}}]},
        {"name": "human", "action": [{"name": "move", "integer": {"min": 0, "max": OTHER - 1}}]},
    ],
}
# BLAKE3 of the above as the service has it: `schema_hash` of what `GET /v1/environments/NAME` answers. Python's standard library has no BLAKE3,
# and a file with another one is refused, so that the test fails should the environment above and this differ.
SCHEMA_HASH = "103cca22ff8196905d69016e29bb4ab845dcbf5e5a12e416763f9af39ce601c8"
# Mean and deviation that values are standardised by; any do.
SCALES = [None, None, {"mean": 0.25, "deviation": 1.5}, {"mean": 1.75, "deviation": 1.25}]
# Every bin of every feature.
STATES = [[k % 3, k % 8, (2 * k + k // 5) % 5, (k + k // 5) % 5] for k in range(24)]


class Member(torch.nn.Module):
    """A hidden layer of rectified linear units, then the heads."""

    def __init__(self, heads):
        super().__init__()
        self.trunk = torch.nn.Linear(INPUTS, WIDTH)
        self.heads = list(heads)
        for name, outputs in heads.items():
            setattr(self, name, torch.nn.Linear(WIDTH, outputs))

    def forward(self, inputs):
        hidden = torch.relu(self.trunk(inputs))
        return tuple(getattr(self, name)(hidden) for name in self.heads)


class Ensemble(torch.nn.Module):
    """Members that are asked the same."""

    def __init__(self, kind):
        super().__init__()
        cells = len(EGO) * OTHER
        heads = {"ego": len(EGO), "other": OTHER, "interaction": cells} if kind == "joint" else {"influence": 1}
        self.members = torch.nn.ModuleList(Member(heads) for _ in range(MEMBERS))

    def forward(self, inputs):
        return tuple(output for member in self.members for output in member(inputs))


def encoded(states):
    """One a label, sine and cosine of the sector, the whole number and the middle of the bin standardised; the outermost bins reach as far beyond
    their edge as to the middle of the bin before it."""
    held, bearing, lane, distance = numpy.array(states).T
    angle = 2 * numpy.pi * bearing / SECTORS
    widths = numpy.diff(EDGES)
    middles = numpy.array([EDGES[0] - widths[0] / 2, *(EDGES[:-1] + widths / 2), EDGES[-1] + widths[-1] / 2])
    standard = [(x - scale["mean"]) / scale["deviation"] for x, scale in zip((lane + LEAST, middles[distance]), SCALES[2:])]
    columns = [*(held == label for label in range(len(LABELS))), numpy.sin(angle), numpy.cos(angle), *standard]
    return torch.from_numpy(numpy.stack(columns, axis=1).astype(numpy.float32))


def joint_figures(ego, other, interaction):
    """Policies, responses, divergences and mutual information of heads, in 64 bits and nats."""
    ego, other, interaction = (head.double() for head in (ego, other, interaction))
    policy = torch.softmax(ego, dim=1)
    ln_response = torch.log_softmax(other[:, None, :] + interaction.reshape(-1, len(EGO), OTHER), dim=2)
    response = ln_response.exp()
    marginal = (policy[:, :, None] * response).sum(dim=1, keepdim=True)
    divergence = (response * (ln_response - marginal.log())).sum(dim=2)
    information = (policy * divergence).sum(dim=1)
    return {"policy": policy, "response": response, "divergence": divergence, "mutual_information": information}


def direct_figures(influence):
    return {"probability": torch.sigmoid(influence.double()[:, 0])}


def by_onnxruntime(ensemble, inputs):
    with tempfile.TemporaryDirectory() as directory:
        file = Path(directory) / "ensemble.onnx"
        shape = {"inputs": {0: torch.export.Dim("states")}}
        torch.onnx.export(ensemble, (inputs,), file, input_names=["state"], dynamic_shapes=shape, dynamo=True)
        session = onnxruntime.InferenceSession(file, providers=["CPUExecutionProvider"])
        outputs = session.run(None, {"state": inputs.numpy()})
    return [torch.from_numpy(output) for output in outputs]


def made(kind):
    torch.manual_seed(SEED)
    ensemble = Ensemble(kind)
    with torch.no_grad():
        for member in ensemble.members:
            getattr(member, "interaction" if kind == "joint" else "influence").weight.mul_(4)
    return ensemble.eval()


def golden(kind, ensemble, inputs):
    """Returns what a kind of ensemble makes of the states, by both tools."""
    with torch.no_grad():
        by_torch = ensemble(inputs)
    by_onnx = by_onnxruntime(ensemble, inputs)
    apart = max(float((one - other).abs().max()) for one, other in zip(by_torch, by_onnx, strict=True))
    assert apart <= PRECISION, f"{kind}: PyTorch and onnxruntime are {apart} apart"
    figures = joint_figures if kind == "joint" else direct_figures
    names = ensemble.members[0].heads
    members = []
    for at in range(MEMBERS):
        part = slice(at * len(names), (at + 1) * len(names))
        heads = by_torch[part]
        tell = lambda outputs: {name: numbers(output) for name, output in zip(names, outputs)}
        told = {name: numbers(figure) for name, figure in figures(*heads).items()}
        members.append({"heads": tell(heads), "heads_by_onnxruntime": tell(by_onnx[part]), **told})
    print(f"{kind}: {len(STATES)} states, {MEMBERS} members, PyTorch and onnxruntime {apart:.1e} apart")
    return {"members": members}


def numbers(tensor):
    """As short as they can be written without losing a bit of their 32, or 64 rounded to 12 digits."""
    digits = "{:.9g}" if tensor.dtype == torch.float32 else "{:.12g}"
    rounded = lambda value: [rounded(one) for one in value] if isinstance(value, list) else float(digits.format(value))
    return rounded(tensor.tolist())


def metadata(kind):
    return {
        "format": "nudge/1",
        "kind": kind,
        "ego": "robot",
        "other": "human",
        "schema_hash": SCHEMA_HASH,
        "threshold": str(THRESHOLD),
        "scales": json.dumps(SCALES),
        "card": "{}",
    }


def write():
    here = Path(__file__).parent
    inputs = encoded(STATES)
    tools = {name: version(name) for name in ("torch", "numpy", "safetensors", "onnx", "onnxruntime", "onnxscript")}
    meta = {"tools": {"python": platform.python_version(), **tools}, "seed": SEED, "threshold_nats": THRESHOLD}
    answers = {"meta": meta, "environment": ENVIRONMENT, "states": STATES, "inputs": numbers(inputs)}
    for kind in ("joint", "direct"):
        ensemble = made(kind)
        save_file(ensemble.state_dict(), here / f"networks_{kind}.safetensors", metadata(kind))
        answers[kind] = golden(kind, ensemble, inputs)
    (here / "networks.json").write_text(json.dumps(answers) + "\n")


def load(file):
    """Loads an exported file into the modules and tells whether they say the same as those that were written here."""
    with safe_open(file, "pt") as opened:
        kind = opened.metadata()["kind"]
    ensemble = Ensemble(kind)
    ensemble.load_state_dict(load_file(file), strict=True)
    with torch.no_grad():
        pairs = zip(ensemble(encoded(STATES)), made(kind)(encoded(STATES)))
        apart = max(float((one - other).abs().max()) for one, other in pairs)
    print(f"{file}: {kind}, loaded; its heads are {apart:.1e} from those of the file that was written here")


if __name__ == "__main__":
    for name in sys.argv[1:]:
        load(name)
    if not sys.argv[1:]:
        write()
