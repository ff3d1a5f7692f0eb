"""Writes estimators.json: high-precision references for the tables of mi_tables.json.

Needs mpmath (`pip install mpmath`; written with 1.4.1 on Python 3.11). Run beside the two files:
`python estimators.py`. It takes some minutes. All values in nats, from these formulas:

- nsb: Nemenman, Shafee & Bialek 2002. The posterior mean of the entropy of K letters under a mixture of symmetric
  Dirichlet priors with concentration b a letter, weighted so that the prior mean of the entropy is uniform, by
  Gauss-Legendre quadrature in ln b; S(rows) + S(columns) - S(cells), K from the shape of the table.
- grassberger_2003: G(n) = psi(n) + (-1)^n/2 (psi((n+1)/2) - psi(n/2)), H = ln N - sum n G(n) / N, H(rows) +
  H(columns) - H(cells) over what is occupied.
- chao_shen: Chao & Shen 2003, coverage 1 - f1/N, with f1 = N - 1 where all are singletons.
- james_stein: Hausser & Strimmer 2009, the whole table shrunk to uniform, then its mutual information.
- uniform_policy: mean divergence of the rows with at least three visits from their unweighted mean.
"""

import json
import platform
from functools import lru_cache
from pathlib import Path

import mpmath
from mpmath import digamma, exp, log, loggamma, mp, mpf, polygamma, quad

mp.dps = 50


def margins(table):
    return [sum(row) for row in table], [sum(column) for column in zip(*table)]


def by_entropies(entropy, table):
    rows, columns = margins(table)
    cells = [n for row in table for n in row]
    return entropy(rows) + entropy(columns) - entropy(cells)


def nsb(counts):
    letters, total = len(counts), sum(counts)
    if letters == 1:
        return mpf(0)
    if total == 0:
        return log(letters) / 2
    times = {n: counts.count(n) for n in set(counts)}

    def log_weight(u):
        b = exp(u)
        prior = letters * b * polygamma(1, letters * b + 1) - b * polygamma(1, b + 1)
        evidence = loggamma(letters * b) - loggamma(total + letters * b)
        return log(prior) + evidence + sum(k * (loggamma(n + b) - loggamma(b)) for n, k in times.items() if n)

    def mean_entropy(u):
        b = exp(u)
        whole = total + letters * b
        return digamma(whole + 1) - sum(k * (n + b) / whole * digamma(n + b + 1) for n, k in times.items())

    steps = [mpf(u) / 4 for u in range(-320, 321)]
    logs = [log_weight(u) for u in steps]
    peak = max(logs)
    wanted = [u for u, value in zip(steps, logs) if value > peak - 50]
    ends = [min(wanted) + mpf(i) / 4 for i in range(int((max(wanted) - min(wanted)) * 4) + 1)]
    ends = [ends[0] - mpf(1) / 4, *ends, ends[-1] + mpf(1) / 4]
    weight = lru_cache(None)(lambda u: exp(log_weight(u) - peak))
    with_entropy = lambda u: weight(u) * mean_entropy(u)
    gauss = lambda f: quad(f, ends, method="gauss-legendre", maxdegree=3)
    return gauss(with_entropy) / gauss(weight)


def grassberger(counts):
    total = sum(counts)
    if total == 0:
        return mpf(0)
    g = lambda n: digamma(n) + mpf((-1) ** n) / 2 * (digamma(mpf(n + 1) / 2) - digamma(mpf(n) / 2))
    mp.dps += 20
    entropy = log(total) - sum(n * g(n) for n in counts if n) / total
    mp.dps -= 20
    return entropy


def chao_shen(counts):
    total = sum(counts)
    if total == 0:
        return mpf(0)
    singletons = counts.count(1)
    coverage = 1 - mpf(singletons if singletons < total else total - 1) / total
    shares = [coverage * n / total for n in counts if n]
    return -sum(p * log(p) / (1 - (1 - p) ** total) for p in shares)


def information(shares):
    rows, columns = margins(shares)
    return sum(
        p * log(p / (rows[i] * columns[j])) for i, row in enumerate(shares) for j, p in enumerate(row) if p
    )


def james_stein(table):
    total, letters = sum(map(sum, table)), len(table) * len(table[0])
    if total <= 1:
        return mpf(0)
    target = mpf(1) / letters
    shares = [[mpf(n) / total for n in row] for row in table]
    variance = (1 - sum(p * p for row in shares for p in row)) / (total - 1)
    distance = sum((target - p) ** 2 for row in shares for p in row)
    shrinkage = min(mpf(1), variance / distance) if distance else mpf(1)
    return information([[shrinkage * target + (1 - shrinkage) * p for p in row] for row in shares])


def uniform_policy(table):
    rows = [row for row in table if sum(row) >= 3]
    if not rows:
        return mpf(0)
    return information([[mpf(n) / sum(row) / len(rows) for n in row] for row in rows])


def main():
    here = Path(__file__).parent
    tables = json.loads((here / "mi_tables.json").read_text())["tables"]
    answers = {}
    for table in tables:
        counts = table["counts"]
        answers[table["id"]] = {
            "nsb": float(by_entropies(nsb, counts)),
            "grassberger_2003": float(by_entropies(grassberger, counts)),
            "chao_shen": float(by_entropies(chao_shen, counts)),
            "james_stein": float(james_stein(counts)),
            "uniform_policy": float(uniform_policy(counts)),
        }
        print(table["id"], answers[table["id"]], flush=True)
    tool = f"mpmath {mpmath.__version__}, {mp.dps} digits, Python {platform.python_version()}"
    (here / "estimators.json").write_text(json.dumps({"tool": tool, "tables": answers}, indent=1) + "\n")


if __name__ == "__main__":
    main()
