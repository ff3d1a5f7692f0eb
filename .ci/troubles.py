"""Makes the trouble of every alert with the real binary and a real Prometheus: each fires where its trouble is, and none on a service that is well.

The rules are those of `ops`, made faster by rule and not by hand: whatever they wait for lasts a second, whatever they look back over lasts `LOOK_BACK`.
Times and amounts that no test can wait for are smaller here (`SMALLER`); that the true ones are kept is what `alerts_test.yml` is for.

Needs the standard library, `prometheus`, `openssl` and Linux only.
"""

import concurrent.futures
import contextlib
import itertools
import json
import os
import pathlib
import re
import resource
import signal
import socket
import sqlite3
import ssl
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request

import dashboards
import inference_world
from inference_world import check

LOOK_BACK = "15s"
SMALLER = {
    "NudgeQueueFull": {"> 256000": "> 20000"},
    "NudgeNobodySends": {"> 3600": "> 20"},
    "NudgeFitsOld": {"> 86400": "> 3"},
}
# What scrapes services that show a certificate, whoever signed it.
OVER_TLS = """
  - job_name: nudge_over_tls
    scheme: https
    tls_config:
      insecure_skip_verify: true
    static_configs:
      - targets: [%s]
"""
# Alerts of which there is no trouble on a machine that lets nobody mount: told where it is so.
NEEDS_A_DISK = "NudgeDiskFull"
BINARY = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", "target")) / "debug/nudge"


def main(data):
    data = pathlib.Path(data)
    well, cut, small, busy, full = (Service(data, name) for name in ("well", "cut", "small", "busy", "full"))
    brief = Service(data, "brief", "https")
    services = [well, cut, small, busy, full, brief]
    address = f"127.0.0.1:{free_port()}"
    with contextlib.ExitStack() as ends:
        for service in services:
            ends.callback(service.kill)
        troubles = [
            Trouble(cut, cannot_commit, ["NudgeNotReady", "NudgeCommitsFail", "NudgeErrors", "NudgeTrainingFailed"]),
            Trouble(small, too_small, ["NudgeQuotaFull", "NudgeSheds", "NudgeSlow", "NudgeRejects", "NudgeFitsOld", "NudgeFilesRunOut", "NudgeNobodySends"]),
            Trouble(busy, too_much, ["NudgeQueueFull", "NudgeQuestionsWait", "NudgeEnvironmentDamaged", "NudgeDown"]),
            Trouble(brief, lambda _, told: told("NudgeCertificateExpires"), ["NudgeCertificateExpires"]),
        ]
        if full.start_on_a_full_disk():
            troubles.append(Trouble(full, lambda _, told: told(NEEDS_A_DISK), [NEEDS_A_DISK]))
        else:
            services.remove(full)
            print(f"ok: nobody may mount here, so {NEEDS_A_DISK} is left to promtool", flush=True)
        well.start()
        cut.start()
        small.start("--max-cells", "38", "--max-connections", "12", "--fit-every", "0s")
        busy.start()
        brief.start(*brief_certificate(brief.data))
        start_prometheus(data, address, services, ends)
        make(address, well, troubles)


class Trouble:
    """What is done to a service, and the alerts that are to tell it."""

    def __init__(self, service, made, alerts):
        self.service, self.made, self.alerts = service, made, alerts


def make(address, well, troubles):
    """Makes every trouble, waits until each alert fires, and looks that none other fired."""
    names = {rule["name"] for group in dashboards.ask(address, "rules")["groups"] for rule in group["rules"]}
    made = {alert for trouble in troubles for alert in trouble.alerts} | {NEEDS_A_DISK}
    check(names == made, None, f"alerts without a trouble, or troubles without an alert: {names ^ made}")
    over = threading.Event()
    with concurrent.futures.ThreadPoolExecutor() as pool:
        working = pool.submit(work, well, over)
        try:
            done = [pool.submit(trouble.made, trouble.service, teller(address, trouble.service)) for trouble in troubles]
            for trouble in concurrent.futures.as_completed(done):
                trouble.result()
        finally:
            over.set()
        working.result()
    fired = {(sample["metric"]["instance"], sample["metric"]["alertname"]) for sample in ever(address)}
    # What little disk a machine of CI has left is no fault of the service's.
    wrong = {alert for instance, alert in fired if instance == well.address} - {NEEDS_A_DISK}
    check(not wrong, "no alert fired for the service that is well", wrong)


def ever(address):
    return dashboards.ask(address, "query", query='max_over_time(ALERTS{alertstate="firing"}[10m])')["result"]


def teller(address, service):
    """Returns what waits until an alert fires for a service, and says so."""

    def told(alert):
        query = f'max_over_time(ALERTS{{alertstate="firing",alertname="{alert}",instance="{service.address}"}}[10m])'
        fires = dashboards.until(lambda: dashboards.ask(address, "query", query=query)["result"], f"{alert} fires for the service that is {service.name}")
        check(fires, None, f"{alert} does not fire for the service that is {service.name}")

    return told


# --- The troubles ---


def brief_certificate(data):
    """Makes a certificate that ends in three days, and returns the flags that show it."""
    certificate, key = data / "tls.crt", data / "tls.key"
    subject = ["-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost"]
    files = ["-keyout", str(key), "-out", str(certificate)]
    subprocess.run(["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "3", *subject, *files], check=True, capture_output=True)
    return "--tls-cert", str(certificate), "--tls-key", str(key)


def work(service, over):
    """A service that is well counts, answers and trains."""
    inference_world.prepare(service.url)
    sequence = 0
    while not over.is_set():
        sequence += 1
        send(service, "steady", sequence, inference_world._transitions()[:20])
        ask(service)
        time.sleep(0.5)


def cannot_commit(service, told):
    """Files may not grow any longer, as on a full disk: nothing is committed, and no network is kept."""
    inference_world.prepare(service.url)
    service.limit(resource.RLIMIT_FSIZE, 4_096)
    with until_it_is_over() as over:
        over.also(lambda: send(service, "cut", 1, inference_world._transitions(), refused=True))
        options = {"width": 4, "members": 1, "folds": 2, "epochs": 1}
        over.also(lambda: call_anyway("POST", f"{service.url}/v1/environments/world/models", options))
        for alert in ("NudgeNotReady", "NudgeCommitsFail", "NudgeErrors", "NudgeTrainingFailed"):
            told(alert)


def too_small(service, told):
    """Its quota, its connections and its files are used up, its senders are slow and wrong, and then gone."""
    put(service)
    send(service, "small", 1, inference_world._transitions()[:36])
    inference_world.call("POST", f"{service.url}/v1/environments/world/fit", {})
    ask(service)
    again = {"state": {"place": 0, "light": 0}, "actions": {"robot": 0, "human": 0}, "count": 1_000}
    sequences = itertools.count(2)
    with until_it_is_over() as over:
        over.also(lambda: send(service, "small", next(sequences), [again, {"state": {}, "actions": {}}]))
        for alert in ("NudgeQuotaFull", "NudgeRejects", "NudgeFitsOld"):
            told(alert)
    # The slow ones hold every connection, and what they send takes longer than anybody should wait.
    with contextlib.ExitStack() as ends:
        slow = [ends.enter_context(slow_sender(service)) for _ in range(12)]
        turned_away(service)
        time.sleep(7)
        for sender in slow:
            sender.sendall(b"}")
            sender.recv(1_000)
    told("NudgeSheds")
    told("NudgeSlow")
    with contextlib.ExitStack() as ends:
        for _ in range(6):
            ends.enter_context(slow_sender(service))
        time.sleep(2)
        service.limit(resource.RLIMIT_NOFILE, len(os.listdir(f"/proc/{service.process.pid}/fd")) + 1)
        told("NudgeFilesRunOut")
    told("NudgeNobodySends")


def too_much(service, told):
    """Nobody lets it write while much is sent, too much is asked at once; then its database is damaged, and in the end it is gone."""
    inference_world.prepare(service.url)
    lines = b"\n".join(json.dumps(transition).encode() for transition in inference_world._transitions())
    path = f"{service.url}/v1/environments/world"
    with concurrent.futures.ThreadPoolExecutor(8) as pool, until_it_is_over() as over:
        over.also(lambda: list(pool.map(lambda i: lines_anyway(f"{path}/transitions?producer=crowd-{i}&sequence=1", lines), range(8))))
        with writing(service):
            told("NudgeQueueFull")
    keys = {"keys": [f"{place}.{light}" for place in range(40) for light in range(2)] * 10, "view": "full"}
    with concurrent.futures.ThreadPoolExecutor(140) as pool, until_it_is_over() as over:
        over.also(lambda: list(pool.map(lambda _: call_anyway("POST", f"{path}/influence", keys), range(140))))
        told("NudgeQuestionsWait")
    service.stop()
    with contextlib.closing(sqlite3.connect(service.data / "nudge.db")) as database:
        damage(database)
    service.start()
    told("NudgeEnvironmentDamaged")
    service.stop()
    told("NudgeDown")


# --- What they are made of ---


class Service:
    """A service that is started, hurt and stopped, under one address."""

    def __init__(self, data, name, scheme="http"):
        self.name, self.data, self.scheme = name, data / name, scheme
        self.data.mkdir()
        self.address = f"127.0.0.1:{free_port()}"
        self.url = f"{scheme}://{self.address}"
        self.process = None

    def start(self, *flags, before=()):
        command = [*before, str(BINARY.resolve()), "serve", "--listen", self.address, "--data", str(self.data), *flags]
        # By way of a pipe, for a file could be one that may not grow.
        log = subprocess.Popen(["cat"], stdin=subprocess.PIPE, stdout=(self.data.parent / f"{self.name}.log").open("ab"))
        ignored = lambda: signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        self.process = subprocess.Popen(command, stdout=log.stdin, stderr=log.stdin, restore_signals=False, preexec_fn=ignored)
        log.stdin.close()
        ready = dashboards.until(self.is_ready, None)
        check(ready, None, f"the service that is {self.name} did not start")

    def start_on_a_full_disk(self):
        """Starts it on a small disk of its own with little room, which goes with it; returns whether there may be one."""
        script = 'mount -t tmpfs -o size=32m tmpfs "$1" && head -c 30m /dev/zero >"$1/ballast" && shift && exec "$@"'
        before = ["unshare", "--mount", "sh", "-c", script, "sh", str(self.data)]
        if subprocess.run([*before, "true"], stderr=subprocess.DEVNULL).returncode != 0:
            return False
        self.start(before=before)
        return True

    def is_ready(self):
        try:
            # Who it is does not matter here.
            with urllib.request.urlopen(f"{self.url}/readyz", timeout=5, context=ssl._create_unverified_context()):
                return True
        except OSError:
            check(self.process.poll() is None, None, f"the service that is {self.name} ended")
            return False

    def limit(self, what, most):
        resource.prlimit(self.process.pid, what, (most, resource.prlimit(self.process.pid, what)[1]))

    def stop(self):
        self.process.terminate()
        check(self.process.wait(timeout=30) == 0, None, f"the service that is {self.name} ended with {self.process.returncode}")

    def kill(self):
        if self.process and self.process.poll() is None:
            self.process.kill()
            self.process.wait()


class until_it_is_over:
    """Does things again and again beside what is done within."""

    def __enter__(self):
        self.over, self.threads = threading.Event(), []
        return self

    def also(self, doing):
        def again():
            while not self.over.wait(0.2):
                doing()

        self.threads.append(threading.Thread(target=again))
        self.threads[-1].start()

    def __exit__(self, *_):
        self.over.set()
        for thread in self.threads:
            thread.join()


def put(service):
    inference_world.call("PUT", f"{service.url}/v1/environments/world", inference_world._description())


def send(service, producer, sequence, transitions, refused=False):
    call = call_anyway if refused else inference_world.call
    call("POST", f"{service.url}/v1/environments/world/transitions", {"producer": producer, "sequence": sequence, "transitions": transitions})


def ask(service):
    inference_world.call("POST", f"{service.url}/v1/environments/world/influence", {"keys": ["0.0", "1.1"]})


def call_anyway(method, url, body):
    """Calls, and does not mind a refusal."""
    with contextlib.suppress(OSError):
        inference_world.call(method, url, body)


def lines_anyway(url, lines):
    with contextlib.suppress(OSError):
        urllib.request.urlopen(urllib.request.Request(url, lines, {"content-type": "application/x-ndjson"}, method="POST"), timeout=30).close()


@contextlib.contextmanager
def slow_sender(service):
    """Yields a connection with a request whose last byte is missing."""
    host, port = service.address.split(":")
    with socket.create_connection((host, int(port))) as connection:
        head = f"POST /v1/environments/world/fit HTTP/1.1\r\nhost: {host}\r\ncontent-type: application/json\r\ncontent-length: 2\r\n\r\n{{"
        connection.sendall(head.encode())
        yield connection


def turned_away(service):
    """Asks until there is no room for it."""
    url = f"{service.url}/v1/environments"
    deadline = time.monotonic() + 5
    while time.monotonic() < deadline:
        try:
            urllib.request.urlopen(url, timeout=5).close()
        except urllib.error.HTTPError as error:
            check(error.code == 503, None, error)
            return
        except ConnectionError:
            # Its own connection made room for another.
            pass
    check(False, "who is one too many is turned away")


@contextlib.contextmanager
def writing(service):
    """Holds the right to write, as an operator's shell might."""
    with contextlib.closing(sqlite3.connect(service.data / "nudge.db", isolation_level=None, timeout=30)) as database:
        database.execute("begin immediate")
        yield
        database.execute("rollback")


def damage(database):
    """Changes a sum behind the service's back."""
    database.execute("update totals set transitions = transitions + 1")
    database.commit()


def start_prometheus(data, address, services, ends):
    config, rules = (dashboards.OPS / "prometheus/scrape.yml").read_text(), faster((dashboards.OPS / "prometheus/alerts.yml").read_text())
    (data / "alerts.yml").write_text(rules)
    targets = {
        scheme: ", ".join(f'"{service.address}"' for service in services if service.scheme == scheme) for scheme in ("http", "https")
    }
    for old, new in {'"localhost:8080"': targets["http"], ": 15s": ": 1s"}.items():
        check(old in config, None, f"no {old} in scrape.yml")
        config = config.replace(old, new)
    (data / "prometheus.yml").write_text(config + OVER_TLS % targets["https"])
    command = ["prometheus", f"--config.file={data}/prometheus.yml", f"--storage.tsdb.path={data}/tsdb", f"--web.listen-address={address}"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=(data / "prometheus.log").open("w"))
    ends.callback(lambda: (process.terminate(), process.wait()))
    check(dashboards.until(lambda: dashboards.up(address), "Prometheus scrapes them"), None, "it does not")


def faster(rules):
    """Returns rules that wait for a second and look back for little, with amounts that a test can make."""
    rules = re.sub(r"for: [1-9]\d*[smh]", "for: 1s", rules)
    rules = re.sub(r"\[\d+[smh]\]", f"[{LOOK_BACK}]", rules)
    for alert, changes in SMALLER.items():
        before, name, rest = rules.partition(f"alert: {alert}\n")
        rule, dash, after = rest.partition("- alert:")
        for old, new in changes.items():
            check(old in rule, None, f"no {old} in {alert}")
            rule = rule.replace(old, new)
        rules = before + name + rule + dash + after
    return rules


def free_port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


if __name__ == "__main__":
    main(sys.argv[1])
