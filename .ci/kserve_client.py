"""KServe's own client, over REST and gRPC, against a running service: `kserve_client.py URL`."""

import asyncio
import logging
import sys

import grpc
import httpx
import numpy as np
from kserve import InferenceGRPCClient, InferenceRESTClient, InferInput, InferRequest, RESTConfig
from kserve.protocol.infer_type import RequestedOutput

import inference_world as world
from inference_world import MODEL, OUTPUTS, check


async def main(url):
    world.prepare(url)
    # The client logs every refusal with its traceback, and refusals are wanted here.
    logging.disable(logging.ERROR)
    async with InferenceRESTClient(RESTConfig(protocol="v2")) as rest:
        async with InferenceGRPCClient(url.removeprefix("http://")) as remote:
            await health(url, rest, remote)
            for number in [1, 1_024]:
                await figures(number, url, rest, remote)
            await refusals(url, rest, remote)


async def health(url, rest, remote):
    check(await rest.is_server_live(url) and await rest.is_server_ready(url), "rest: the server is live and ready")
    check(await remote.is_server_live() and await remote.is_server_ready(), "grpc: the server is live and ready")
    check(await rest.is_model_ready(url, MODEL), "rest: the model is ready")
    check(await remote.is_model_ready(MODEL), "grpc: the model is ready")
    check(not await rest.is_model_ready(url, "nowhere"), "rest: an unknown model is not ready")
    check(not await remote.is_model_ready("nowhere"), "grpc: an unknown model is not ready")


async def figures(number, url, rest, remote):
    """Checks that every way to send and to receive gets the same figures."""
    rows = np.array(world.rows(number), dtype=np.float32)
    answers = {
        "grpc, raw": await remote.infer(request(rows)),
        "grpc, typed": await remote.infer(request(rows, raw=False)),
        "rest, JSON": await rest.infer(url, request(rows, raw=False), MODEL),
        "rest, binary in": await rest.infer(url, request(rows), MODEL),
        "rest, binary": await rest.infer(url, request(rows, binary_outputs=True), MODEL),
    }
    told = lambda answer: {output.name: output.as_numpy() for output in answer.outputs}
    reference = told(answers["grpc, raw"])
    check(list(reference) == OUTPUTS, f"{number} rows: the outputs are {OUTPUTS}", list(reference))
    for way, answer in answers.items():
        found = told(answer)
        same = all(np.array_equal(found[name], reference[name]) for name in OUTPUTS)
        check(same and found[OUTPUTS[0]].shape == (number,), f"{number} rows, {way}: the same figures", found)
        check(answer.id == "mine" and answer.model_name == MODEL, f"{number} rows, {way}: id and model are told again")
    if number > world.PLACES:
        world.tells_them_apart(reference[OUTPUTS[0]].tolist())


async def refusals(url, rest, remote):
    nan = np.array([[0, 0], [np.nan, 0]], np.float32)
    good = np.zeros((1, 2), np.float32)
    cases = [
        ("a wrong shape", "[rows, 2]: place, light", request(np.zeros((1, 3), np.float32)), MODEL),
        ("a wrong type", 'got "FP64", expected FP32', request(np.zeros((1, 2), np.float64)), MODEL),
        ("NaN", "/inputs/0/data/1/place: got NaN", request(nan), MODEL),
        ("an unknown environment", "unknown environment", request(good, model="nowhere"), "nowhere"),
    ]
    for what, word, message, model in cases:
        await refused(f"rest: {what}", word, rest.infer(url, message, model), httpx.HTTPStatusError)
        await refused(f"grpc: {what}", word, remote.infer(message), grpc.RpcError)


async def refused(what, word, asking, error):
    """Checks that an answer that is awaited is a refusal, whose text has `word` in it."""
    try:
        answer = await asking
    except error as refusal:
        check(word in str(refusal), f"{what} is refused", str(refusal))
    else:
        check(False, f"{what} is refused", answer)


def request(rows, model=MODEL, raw=True, binary_outputs=False):
    datatype = {np.dtype(np.float32): "FP32", np.dtype(np.float64): "FP64"}[rows.dtype]
    tensor = InferInput("state", list(rows.shape), datatype, data=None if raw else rows.flatten().tolist())
    if raw:
        tensor.set_data_from_numpy(rows, binary_data=True)
    outputs = [RequestedOutput(name, {"binary_data": True}) for name in OUTPUTS] if binary_outputs else None
    return InferRequest(model, [tensor], request_id="mine", request_outputs=outputs)


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1]))
