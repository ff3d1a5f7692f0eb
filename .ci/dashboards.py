"""Scrapes a service with Prometheus while it works, and asks every query of the dashboard and of the alerts.

Needs the standard library and `prometheus` only.
"""

import json
import math
import os
import pathlib
import re
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.parse
import urllib.request

import inference_world

OPS = pathlib.Path(__file__).parent.parent / "ops"
# What Grafana puts in place of its variables, for a service that is scraped every second.
VARIABLES = {"$__rate_interval": "60s", "$__range": "10m", "$instance": ".*"}
LONGEST_WAIT_SECONDS = 60
# Where there is no TLS there is no certificate; `troubles.py` has a service that shows one.
ONLY_WITH_TLS = {"nudge_tls_certificate_expires_timestamp_seconds"}


# Where Grafana finds Prometheus: by a variable, so that the file can be imported and provisioned alike.
DATASOURCE = {"type": "prometheus", "uid": "${DS_PROMETHEUS}"}
# Units that Grafana knows (`@grafana/data`, valueFormats) and that fit base units.
UNITS = {"short", "percentunit", "s", "bytes", "reqps", "cps", "dateTimeFromNow"}
PANELS = {"row", "stat", "timeseries"}
WIDTH = 24


def main(url, data):
    dashboard = json.loads((OPS / "grafana/nudge.json").read_text())
    faults = list(unsound(dashboard))
    inference_world.check(not faults, f"Grafana can show {len(dashboard['panels'])} panels", faults)
    free = socket.socket()
    free.bind(("127.0.0.1", 0))
    address = "127.0.0.1:%d" % free.getsockname()[1]
    free.close()
    prometheus = start(url, pathlib.Path(data), address)
    try:
        until(lambda: up(address), "Prometheus scrapes the service")
        work(url)
        panels = list(queries(dashboard))
        missing = until(lambda: not empty(address, panels), f"{len(panels)} queries of panels return data")
        inference_world.check(missing, None, [panel for panel in panels if not returns(address, panel[1])])
        legends(address, dashboard)
        alerts(address)
    finally:
        prometheus.terminate()
        prometheus.wait()


def start(url, data, address):
    """Starts Prometheus with the configuration of `ops`, but for the address and the pace."""
    config = (OPS / "prometheus/scrape.yml").read_text()
    changes = {"localhost:8080": url.removeprefix("http://"), ": 15s": ": 1s", "- alerts.yml": f"- {OPS.resolve()}/prometheus/alerts.yml"}
    for old, new in changes.items():
        inference_world.check(old in config, None, f"no {old} in scrape.yml")
        config = config.replace(old, new)
    (data / "prometheus.yml").write_text(config)
    command = ["prometheus", f"--config.file={data}/prometheus.yml", f"--storage.tsdb.path={data}/tsdb", f"--web.listen-address={address}"]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=(data / "prometheus.log").open("w"))


def work(url):
    """Lets the service do once whatever a panel shows: counted, rejected, sent again, asked, fitted, trained, predicted."""
    inference_world.prepare(url)
    path = f"{url}/v1/environments/{inference_world.ENVIRONMENT}"
    batch = {"producer": "panels", "sequence": 1, "transitions": inference_world._transitions()[:10] + [{"state": {}, "actions": {}}]}
    for _ in range(2):
        inference_world.call("POST", f"{path}/transitions", batch)
    for _ in range(3):
        inference_world.call("POST", f"{path}/influence", {"keys": ["0.0", "1.1"]})
        inference_world.call("POST", f"{path}/fit", {})
        rows = inference_world.rows(3)
        body = {"inputs": [{"name": "state", "datatype": "FP32", "shape": [3, 2], "data": rows}]}
        inference_world.call("POST", f"{url}/v2/models/{inference_world.MODEL}/infer", body)
        time.sleep(2)


def unsound(dashboard):
    """Yields what Grafana would not show as it is meant."""
    panels, variables = dashboard["panels"], {variable["name"] for variable in dashboard["templating"]["list"]}
    if dashboard.get("id") is not None or not 0 < len(dashboard["uid"]) <= 40 or "__inputs" in dashboard:
        yield "an id of one Grafana only, no uid, or inputs that provisioning leaves empty"
    if not any(variable["type"] == "datasource" and variable["query"] == "prometheus" for variable in dashboard["templating"]["list"]):
        yield "no variable for the data source"
    ids = [panel["id"] for panel in panels]
    yield from (f"id {number} twice" for number in set(ids) if ids.count(number) > 1)
    yield from (f"{variable['name']}: another data source" for variable in dashboard["templating"]["list"] if variable["type"] == "query" and variable["datasource"] != DATASOURCE)
    used = set(re.findall(r"\$\{?([A-Za-z_]\w*)", json.dumps(dashboard))) - {"__rate_interval", "__range", "__all"}
    yield from (f"${name} is no variable" for name in used - variables)
    yield from overlaps(panels)
    for panel in panels:
        yield from (f"{panel['title']}: {fault}" for fault in unsound_panel(panel))


def unsound_panel(panel):
    place = panel["gridPos"]
    if panel["type"] not in PANELS or not panel["title"]:
        yield "of a type that Grafana does not bring, or without a title"
    if min(place.values()) < 0 or place["x"] + place["w"] > WIDTH or 0 in (place["w"], place["h"]):
        yield f"out of the grid: {place}"
    if panel["type"] == "row":
        return
    targets = panel["targets"]
    if any(source.get("datasource") != DATASOURCE for source in [panel, *targets]):
        yield "another data source"
    if not targets or len({target["refId"] for target in targets}) != len(targets):
        yield "no query, or two of one refId"
    if panel["fieldConfig"]["defaults"].get("unit") not in UNITS:
        yield f"unit {panel['fieldConfig']['defaults'].get('unit')}"
    if not panel.get("description"):
        yield "no description"
    yield from (f"asks every service: {target['expr']}" for target in targets if "$instance" not in target["expr"])


def overlaps(panels):
    taken = {}
    for panel in panels:
        place = panel["gridPos"]
        for x in range(place["x"], place["x"] + place["w"]):
            for y in range(place["y"], place["y"] + place["h"]):
                if (x, y) in taken:
                    yield f"{panel['title']} lies over {taken[x, y]}"
                    return
                taken[x, y] = panel["title"]


def legends(address, dashboard):
    """Checks that what a legend names is a label of what the query returns."""
    for panel in dashboard["panels"]:
        for target in panel.get("targets", []):
            result = ask(address, "query", query=filled(target["expr"]))["result"]
            labels = {label for sample in result for label in sample["metric"]}
            wrong = set(re.findall(r"{{\s*(\w+)\s*}}", target.get("legendFormat", ""))) - labels
            inference_world.check(not wrong, None, f"{panel['title']}: the legend names {wrong}, of {labels}")


def filled(query):
    """Returns a query with what Grafana puts in place of its variables."""
    for variable, value in VARIABLES.items():
        query = query.replace(variable, value)
    inference_world.check("$" not in query, None, f"an unknown variable in {query}")
    return query


def queries(dashboard):
    """Yields the title and the query of every target of every panel."""
    for panel in dashboard["panels"]:
        for target in panel.get("targets", []):
            yield panel["title"], filled(target["expr"])


def empty(address, panels):
    return [title for title, query in panels if not returns(address, query)]


def returns(address, query):
    """Returns whether a query has a result, and one at least that is a number."""
    result = ask(address, "query", query=query)["result"]
    return any(math.isfinite(float(sample["value"][1])) for sample in result)


def up(address):
    try:
        return returns(address, 'up{job="nudge"} == 1')
    except (urllib.error.URLError, ConnectionError):
        return False


def alerts(address):
    """Checks that every alert is evaluated, asks for metrics that exist, has a test, and is silent on a service that is well."""
    rules = [rule for group in ask(address, "rules")["groups"] for rule in group["rules"]]
    tests = (OPS / "prometheus/alerts_test.yml").read_text()
    for rule in rules:
        inference_world.check(rule["health"] == "ok", None, rule)
        inference_world.check(f"alertname: {rule['name']}\n" in tests, None, f"{rule['name']} has no test")
        for name in set(re.findall(r"\b(?:nudge|process)_[a-z_]+", rule["query"])) - ONLY_WITH_TLS:
            inference_world.check(returns(address, name), None, f"{rule['name']} asks for {name}, which there is not")
    firing = [rule["name"] for rule in rules if rule["state"] == "firing"]
    # What little disk a machine of CI has left is no fault of the service's.
    inference_world.check(set(firing) <= {"NudgeDiskFull"}, f"{len(rules)} alerts are evaluated, and silent", firing)


def ask(address, what, **parameters):
    query = urllib.parse.urlencode(parameters)
    with urllib.request.urlopen(f"http://{address}/api/v1/{what}?{query}", timeout=10) as answer:
        return json.load(answer)["data"]


def until(holds, told):
    """Waits until something holds, and says so; returns whether it came to hold."""
    deadline = time.monotonic() + LONGEST_WAIT_SECONDS
    while time.monotonic() < deadline:
        if holds():
            inference_world.check(True, told)
            return True
        time.sleep(0.5)
    return False


if __name__ == "__main__":
    main(*sys.argv[1:])
