"""Triton's own client, over HTTP and gRPC, against a running service: `triton_client.py URL`."""

import sys

import numpy as np
import tritonclient.grpc
import tritonclient.http
from tritonclient.utils import InferenceServerException

import inference_world as world
from inference_world import MODEL, OUTPUTS, check, refused

SHAPES = {"inputs": [("state", "FP32", [-1, 2])], "outputs": [(name, "FP32", [-1]) for name in OUTPUTS]}


def main(url):
    world.prepare(url)
    address = url.removeprefix("http://")
    http = tritonclient.http.InferenceServerClient(address)
    grpc = tritonclient.grpc.InferenceServerClient(address)
    for name, client in [("http", http), ("grpc", grpc)]:
        health(name, client)
    version = metadata(http, grpc)
    for number in [1, 1_024]:
        figures(number, version, http, grpc)
    for name, module, client in [("http", tritonclient.http, http), ("grpc", tritonclient.grpc, grpc)]:
        outputs(name, module, client)
        refusals(name, module, client)
    refused("http: NaN in JSON", "/inputs/0/data/2: got NaN", lambda: http.infer(MODEL, [as_json(nan())]), InferenceServerException)
    http.close()
    grpc.close()


def health(name, client):
    check(client.is_server_live() and client.is_server_ready(), f"{name}: the server is live and ready")
    check(client.is_model_ready(MODEL) and client.is_model_ready(world.ENVIRONMENT), f"{name}: the model is ready")


def metadata(http, grpc):
    """Checks that both tell the same of server and model, and returns the model's version."""
    server, told = http.get_server_metadata(), grpc.get_server_metadata()
    check((server["name"], server["version"]) == (told.name, told.version), f"both are {told.name} {told.version}")
    check(server["extensions"] == list(told.extensions) == ["binary_tensor_data"], "both know binary tensors")
    model, told = http.get_model_metadata(MODEL), grpc.get_model_metadata(MODEL)
    for side, expected in SHAPES.items():
        check([(t["name"], t["datatype"], t["shape"]) for t in model[side]] == expected, f"http: {side} {expected}")
        found = [(t.name, t.datatype, list(t.shape)) for t in getattr(told, side)]
        check(found == expected, f"grpc: {side} are the same", found)
    check(model["versions"] == list(told.versions), f"both know versions {model['versions']}")
    version = model["versions"][-1]
    check(http.is_model_ready(MODEL, version) and grpc.is_model_ready(MODEL, version), f"version {version} is ready")
    for client, name in [(http, "http"), (grpc, "grpc")]:
        check(client.is_model_ready("nowhere") is False, f"{name}: an unknown model is not ready")
    return version


def figures(number, version, http, grpc):
    """Checks that every way to send and to receive gets the same figures."""
    rows = np.array(world.rows(number), dtype=np.float32)
    plain = [tritonclient.http.InferRequestedOutput(name, binary_data=False) for name in OUTPUTS]
    binary = [tritonclient.http.InferRequestedOutput(name, binary_data=True) for name in OUTPUTS]
    answers = {
        "http, binary": http.infer(MODEL, [as_bytes(rows)], request_id="mine"),
        "http, binary in, JSON out": http.infer(MODEL, [as_bytes(rows)], outputs=plain),
        "http, JSON": http.infer(MODEL, [as_json(rows)], outputs=plain),
        "http, JSON in, binary out": http.infer(MODEL, [as_json(rows)], outputs=binary),
        "http, by version": http.infer(MODEL, [as_bytes(rows)], model_version=version),
        "http, by the environment": http.infer(world.ENVIRONMENT, [as_bytes(rows)]),
        "grpc": grpc.infer(MODEL, [of_grpc(rows)], request_id="mine"),
        "grpc, by version": grpc.infer(MODEL, [of_grpc(rows)], model_version=version),
    }
    for algorithm in ["gzip", "deflate"]:
        packed = {"request_compression_algorithm": algorithm, "response_compression_algorithm": algorithm}
        answers[f"http, {algorithm}"] = http.infer(MODEL, [as_bytes(rows)], **packed)
        answers[f"grpc, {algorithm}"] = grpc.infer(MODEL, [of_grpc(rows)], compression_algorithm=algorithm)
    reference = [answers["grpc"].as_numpy(name) for name in OUTPUTS]
    for way, answer in answers.items():
        found = [answer.as_numpy(name) for name in OUTPUTS]
        same = all(np.array_equal(one, other) for one, other in zip(found, reference))
        check(same and found[0].shape == (number,), f"{number} rows, {way}: the same figures", found)
    response = answers["http, binary"].get_response()
    check((response["id"], response["model_version"]) == ("mine", version), "http: the request's id is told again")
    check(answers["grpc"].get_response().id == "mine", "grpc: the request's id is told again")
    probability, information = reference
    check(bool(np.all((probability >= 0) & (probability <= 1) & (information >= 0))), f"{number} rows: figures are possible")
    if number > world.PLACES:
        world.tells_them_apart(probability.tolist())


def outputs(name, module, client):
    """Checks that outputs come as asked."""
    asked = [module.InferRequestedOutput(output) for output in reversed(OUTPUTS)]
    answer = client.infer(MODEL, [tensor(module, np.zeros((2, 2), np.float32))], outputs=asked)
    response = answer.get_response()
    told = [o["name"] for o in response["outputs"]] if name == "http" else [o.name for o in response.outputs]
    check(told == OUTPUTS[::-1], f"{name}: outputs come in the order asked for", told)
    one = client.infer(MODEL, [tensor(module, np.zeros((2, 2), np.float32))], outputs=asked[:1])
    check(one.as_numpy(OUTPUTS[0]) is None, f"{name}: what was not asked for is not told")


def refusals(name, module, client):
    def infer(values, model=MODEL, **options):
        return lambda: client.infer(model, [tensor(module, values)], **options)

    good = np.zeros((1, 2), np.float32)
    unknown = [module.InferRequestedOutput("speed")]
    classes = [module.InferRequestedOutput(OUTPUTS[0], class_count=3)]
    shared = [module.InferRequestedOutput(OUTPUTS[0])]
    shared[0].set_shared_memory("mine", 4)
    cases = [
        ("an output into shared memory", "shared memory is not supported", infer(good, outputs=shared)),
        ("a number of classes", "class_count", infer(good, outputs=classes)),
        ("a wrong shape", "[rows, 2]: place, light", infer(np.zeros((1, 3), np.float32))),
        ("a wrong type", 'got "FP64", expected FP32', infer(np.zeros((1, 2), np.float64))),
        ("NaN", "/inputs/0/data/1/place: got NaN", infer(nan())),
        ("a label that is none", "/inputs/0/data/0/light: got 7", infer(np.array([[0, 7]], np.float32))),
        ("an unknown output", 'got "speed"', infer(good, outputs=unknown)),
        ("an unknown environment", "unknown environment", infer(good, model="nowhere")),
        ("an unknown agent", "unknown agent", infer(good, model="world~robot~cat")),
        ("an unknown version", "version", infer(good, model_version="999")),
    ]
    for what, word, ask in cases:
        refused(f"{name}: {what}", word, ask, InferenceServerException)


def nan():
    return np.array([[0, 0], [np.nan, 0]], np.float32)


def tensor(module, values):
    datatype = {np.dtype(np.float32): "FP32", np.dtype(np.float64): "FP64"}[values.dtype]
    tensor = module.InferInput("state", list(values.shape), datatype)
    tensor.set_data_from_numpy(values)
    return tensor


def of_grpc(values):
    return tensor(tritonclient.grpc, values)


def as_bytes(values):
    return tensor(tritonclient.http, values)


def as_json(values):
    tensor = tritonclient.http.InferInput("state", list(values.shape), "FP32")
    tensor.set_data_from_numpy(values, binary_data=False)
    return tensor


if __name__ == "__main__":
    main(sys.argv[1])
