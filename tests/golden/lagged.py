"""Writes lagged.json: references for lagged, conditional figures, from tracks of two agents to numbers.

Needs mpmath (`pip install mpmath`; written with 1.4.1 on Python 3.11). Run beside the file: `python lagged.py`.

Everything is from the definitions, without the program's code: which entries of a state count as draws (all agents
have acted anew since the state's last entry that counted), the tables of I(ego now; other k later | state, other's
own action at k - 1), one a slice, and of these, in nats at 50 digits:

- plug_in: sum_c n_c / N sum_ij (n_ij / n_c) ln (n_ij n_c / (r_i c_j)).
- expected: its mean over all permutations within slices, by the hypergeometric distribution of each cell.
- p: the probability of all tables with these margins whose sum of n_c I_c is at least as large, by enumeration of
  each slice and convolution; null where there are more than 1,000 tables.
"""

import itertools
import json
import platform
import random
from pathlib import Path

import mpmath
from mpmath import binomial, factorial, log, mp, mpf

mp.dps = 50
MOST_TABLES = 1_000
TIE = mpf(10) ** -20


def track(rng, letters, steps, held, copied):
    """A leader and a follower that copies it two steps later, both holding their actions, in three states."""
    states, actions = [], [[], []]
    state = 0
    for at in range(steps):
        if rng.random() < 0.6:
            state = rng.randrange(3)
        states.append(state)
        for agent in range(2):
            if at and rng.random() < held:
                actions[agent].append(actions[agent][-1])
            elif agent == 1 and at > 1 and rng.random() < copied:
                actions[agent].append(actions[0][at - 2] % letters[1])
            else:
                actions[agent].append(rng.randrange(letters[agent]))
    return {"states": states, "actions": actions}


def draws(track):
    """The steps that count, by the rule's definition."""
    states, actions = track["states"], track["actions"]
    last, found = {}, []
    for at, state in enumerate(states):
        if at and states[at - 1] == state:
            continue
        since = last.get(state)
        anew = since is None or all(
            any(own[t] != own[t - 1] for t in range(since + 1, at + 1)) for own in actions
        )
        if anew:
            last[state] = at
            found.append(at)
    return found


def slices(tracks, state, ego, lag):
    """Counts by the other's own action at lag - 1, then by ego action and later action of the other."""
    counts = {}
    for track in tracks:
        own, other = track["actions"][ego], track["actions"][1 - ego]
        for at in draws(track):
            if track["states"][at] == state and at + lag < len(own):
                given = other[at + lag - 1] if lag else 0
                cell = (own[at], other[at + lag])
                table = counts.setdefault(given, {})
                table[cell] = table.get(cell, 0) + 1
    return [counts[given] for given in sorted(counts)]


def margins(table):
    rows, columns = {}, {}
    for (i, j), n in table.items():
        rows[i] = rows.get(i, 0) + n
        columns[j] = columns.get(j, 0) + n
    return [rows[i] for i in sorted(rows)], [columns[j] for j in sorted(columns)]


def x_ln_x(n):
    return mpf(n) * log(n) if n else mpf(0)


def scaled(cells, rows, columns):
    """n I of a table."""
    return x_ln_x(sum(rows)) + sum(map(x_ln_x, cells)) - sum(map(x_ln_x, rows)) - sum(map(x_ln_x, columns))


def plug_in(tables):
    return sum(scaled(table.values(), *margins(table)) for table in tables) / total(tables)


def total(tables):
    return sum(sum(table.values()) for table in tables)


def expected(tables):
    def of(table):
        rows, columns = margins(table)
        n = sum(rows)
        cell = lambda r, c: sum(
            binomial(c, k) * binomial(n - c, r - k) / binomial(n, r) * x_ln_x(k)
            for k in range(max(1, r + c - n), min(r, c) + 1)
        )
        cells = sum(cell(r, c) for r in rows for c in columns)
        return x_ln_x(n) + cells - sum(map(x_ln_x, rows)) - sum(map(x_ln_x, columns))

    return sum(map(of, tables)) / total(tables)


def rows_of(total, columns):
    """Every way to deal a row of this sum to what is left of the columns."""
    if len(columns) == 1:
        return [(total,)] if total <= columns[0] else []
    return [
        (first, *rest)
        for first in range(min(total, columns[0]) + 1)
        for rest in rows_of(total - first, columns[1:])
    ]


def tables_of(rows, columns):
    if len(rows) == 1:
        yield tuple(columns)
        return
    for row in rows_of(rows[0], columns):
        left = [c - k for c, k in zip(columns, row)]
        for rest in tables_of(rows[1:], left):
            yield (*row, *rest)


def distribution(table):
    rows, columns = margins(table)
    ways = mpf(1)
    for margin in [*rows, *columns]:
        ways *= factorial(margin)
    ways /= factorial(sum(rows))
    found = []
    for cells in itertools.islice(tables_of(rows, columns), MOST_TABLES + 1):
        probability = ways
        for n in cells:
            probability /= factorial(n)
        found.append((scaled(cells, rows, columns), probability))
    return found


def p_value(tables):
    telling = [table for table in tables if min(map(len, margins(table))) > 1]
    number, found = 1, [(mpf(0), mpf(1))]
    for of_slice in map(distribution, telling):
        number *= len(of_slice)
        if number > MOST_TABLES:
            return None
        found = [(a + b, p * q) for a, p in found for b, q in of_slice]
    seen = sum(scaled(table.values(), *margins(table)) for table in telling)
    return float(sum(p for value, p in found if value >= seen - TIE))


def main():
    rng = random.Random(17)
    worlds = [
        ("2x2 short", (2, 2), 2, 16, 0.4, 0.8),
        ("2x3 held", (2, 3), 3, 30, 0.6, 0.5),
        ("4x4", (4, 4), 6, 60, 0.3, 0.7),
        ("6x6 held", (6, 6), 12, 80, 0.6, 0.9),
        ("1x3", (1, 3), 3, 20, 0.3, 0.5),
    ]
    cases = []
    for name, letters, number, steps, held, copied in worlds:
        tracks = [track(rng, letters, steps, held, copied) for _ in range(number)]
        figures = []
        for state, ego, lag in itertools.product(range(3), range(2), range(5)):
            tables = slices(tracks, state, ego, lag)
            figures.append(
                {
                    "state": state,
                    "ego": ego,
                    "lag": lag,
                    "draws": total(tables),
                    "plug_in": float(plug_in(tables)),
                    "expected": float(expected(tables)),
                    "p": p_value(tables),
                }
            )
        cases.append({"name": name, "letters": letters, "tracks": tracks, "figures": figures})
    tool = f"mpmath {mpmath.__version__}, {mp.dps} digits, Python {platform.python_version()}"
    text = json.dumps({"tool": tool, "worlds": cases}, separators=(",", ":"))
    Path(__file__).with_name("lagged.json").write_text(text.replace('{"name"', '\n{"name"').replace('{"state"', '\n{"state"') + "\n")
    known = [figure["p"] for case in cases for figure in case["figures"]]
    print(len(known), "questions,", sum(p is not None for p in known), "with an exact p,", min(p for p in known if p))


if __name__ == "__main__":
    main()
