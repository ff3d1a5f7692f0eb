"""Yardsticks for `cargo bench --bench ingest` and `--bench sizes`: the same rows counted durably by Redis and by PostgreSQL on this machine.

    apt-get install redis-server postgresql
    python3 -m venv v; v/bin/pip install 'psycopg[binary]'
    v/bin/python benches/ingest_yardsticks.py

Redis: HINCRBY, one hash a state, append-only file flushed always, by pipelines of several depths. PostgreSQL: upserts from unnest in order of
key, fsync and synchronous_commit on, by several batches a commit. Both over a Unix socket, from one client whose requests are made before the
clock starts. Prints each load's best and every other figure, in transitions a second. A server that is not installed is left out, and said so.
"""

import getpass
import glob
import os
import pwd
import random
import shutil
import socket
import subprocess
import tempfile
import time

HOT, UNIFORM = 223, 1_000_000
JOINT = 36
TRANSITIONS = 400_000
DEPTHS = (100, 1_000, 10_000, 50_000)


def transitions(states, seed):
    """Returns (state, joint action) of every transition, uniformly over the states."""
    generator = random.Random(seed)
    return [(generator.randrange(states), generator.randrange(JOINT)) for _ in range(TRANSITIONS)]


def chunks(rows, size):
    return [rows[at : at + size] for at in range(0, len(rows), size)]


def as_server_user(command):
    """Returns a command as a user whom PostgreSQL's server accepts: not the superuser of the machine."""
    return ["runuser", "-u", "postgres", "--", *command] if getpass.getuser() == "root" else command


def program(name):
    """Returns the path of a server's program, which Debian keeps out of PATH."""
    found = shutil.which(name) or next(iter(sorted(glob.glob(f"/usr/lib/postgresql/*/bin/{name}"), reverse=True)), None)
    return found


class Redis:
    """A server on an empty directory."""

    name = "Redis HINCRBY, AOF always"

    def __init__(self, directory):
        self.path = os.path.join(directory, "redis.sock")
        options = ["--port", "0", "--unixsocket", self.path, "--dir", directory, "--save", "", "--appendonly", "yes", "--appendfsync", "always"]
        self.server = subprocess.Popen([program("redis-server"), *options], stdout=subprocess.DEVNULL)
        self.socket = socket.socket(socket.AF_UNIX)
        until(lambda: self.socket.connect(self.path))

    def requests(self, rows, depth):
        def request(state, joint):
            parts = [b"HINCRBY", b"s%d" % state, b"%d" % joint, b"1"]
            return b"*4\r\n" + b"".join(b"$%d\r\n%s\r\n" % (len(part), part) for part in parts)

        return [(len(chunk), b"".join(request(*row) for row in chunk)) for chunk in chunks(rows, depth)]

    def send(self, request):
        answers, pipeline = request
        self.socket.setblocking(False)
        sent = received = 0
        # Read while it is written: a deep pipeline's answers fill the socket.
        while received < answers:
            if sent < len(pipeline):
                try:
                    sent += self.socket.send(pipeline[sent : sent + 65_536])
                except BlockingIOError:
                    pass
            try:
                received += self.socket.recv(65_536).count(b"\n")
            except BlockingIOError:
                time.sleep(0.000_02)

    def clear(self):
        self.send((1, b"*1\r\n$8\r\nFLUSHALL\r\n"))

    def stop(self):
        self.socket.close()
        self.server.terminate()
        self.server.wait()


class PostgreSQL:
    """A cluster in an empty directory."""

    name = "PostgreSQL unnest upserts, fsync on"

    def __init__(self, directory):
        import psycopg

        data = os.path.join(directory, "data")
        if getpass.getuser() == "root":
            user = pwd.getpwnam("postgres")
            os.chown(directory, user.pw_uid, user.pw_gid)
        subprocess.run(as_server_user([program("initdb"), "-D", data, "-A", "trust", "-U", "bench"]), check=True, stdout=subprocess.DEVNULL)
        options = ["-c", "listen_addresses=", "-c", f"unix_socket_directories={directory}", "-c", "shared_buffers=512MB", "-c", "max_wal_size=4GB"]
        self.server = subprocess.Popen(as_server_user([program("postgres"), "-D", data, *options]), stderr=subprocess.DEVNULL)
        self.connection = None

        def connect():
            self.connection = psycopg.connect(host=directory, user="bench", dbname="postgres", autocommit=True)

        until(connect)
        self.connection.execute("create table cells (state int8, joint int8, n int8, primary key (state, joint))")

    def requests(self, rows, batch):
        return [tuple(map(list, zip(*chunk))) for chunk in chunks(rows, batch)]

    def send(self, request):
        states, joints = request
        self.connection.execute(
            """insert into cells select state, joint, count(*) from unnest(%s::int8[], %s::int8[]) as t (state, joint)
               group by state, joint order by state, joint
               on conflict (state, joint) do update set n = cells.n + excluded.n""",
            (states, joints),
        )

    def clear(self):
        self.connection.execute("truncate cells")

    def stop(self):
        self.connection.close()
        self.server.terminate()
        self.server.wait()


def until(succeeds, patience=30):
    """Tries again until it succeeds: servers take a moment."""
    late = time.monotonic() + patience
    while True:
        try:
            return succeeds()
        except Exception:
            if time.monotonic() > late:
                raise
            time.sleep(0.05)


def measure(server, states):
    """Prints the rate at every depth, and the best."""
    rates = {}
    for depth in DEPTHS:
        # So that shallow ones do not take minutes.
        rows = transitions(states, seed=depth)[: 100 * depth]
        requests = server.requests(rows, depth)
        server.clear()
        started = time.perf_counter()
        for request in requests:
            server.send(request)
        rates[depth] = len(rows) / (time.perf_counter() - started)
    best = max(rates, key=rates.get)
    load = "8,000 hot cells" if states == HOT else "uniform over a million states"
    others = ", ".join(f"{depth}: {rate:,.0f}" for depth, rate in rates.items())
    print(f"{server.name}, {load}: {rates[best]:,.0f} transitions/s at {best} a request ({others})", flush=True)


def main():
    for make, needed in [(Redis, "redis-server"), (PostgreSQL, "postgres")]:
        if program(needed) is None:
            print(f"{make.name}: {needed} is not installed")
            continue
        with tempfile.TemporaryDirectory() as directory:
            server = make(directory)
            try:
                for states in (HOT, UNIFORM):
                    measure(server, states)
            finally:
                server.stop()


if __name__ == "__main__":
    main()
