"""Writes pooled.json: references for pooled evidence, by brute force and from the definitions.

Needs mpmath, scipy and statsmodels (`pip install mpmath scipy statsmodels`; written with mpmath 1.4.1, scipy 1.17.1 and
statsmodels 0.15.0 on Python 3.11.7). Run beside the file: `python pooled.py`.

- margins: of all tables with these margins, each with its probability prod r! prod c! / (N! prod n!), the mean and
  variance of T = sum n ln(n N / (r c)) in nats at 50 digits, and of Pearson's X^2 as exact fractions.
- pools: strata (state, segment, rows of counts), and of each pool T, M, V, the upper tail of the gamma distribution,
  the generalised Cochran-Mantel-Haenszel statistic by Gauss-Jordan elimination in fractions with its rank and p, the
  size, its share and both intervals. Where all strata are 2 x 2, statsmodels' Mantel-Haenszel test must agree.
"""

import json
import platform
import random
from fractions import Fraction
from pathlib import Path

import mpmath
import numpy
import scipy
import scipy.stats
import statsmodels
from mpmath import factorial, gammainc, log, mp, mpf, sqrt
from statsmodels.stats.contingency_tables import StratifiedTable

mp.dps = 50

MARGINS = [
    ([1, 1], [1, 1]),
    ([2, 1], [2, 1]),
    ([1, 1, 1], [2, 1]),
    ([1, 1, 1], [1, 1, 1]),
    ([2, 2], [3, 1]),
    ([7, 2], [4, 5]),
    ([3, 3, 2], [4, 4]),
    ([5, 1, 1, 1], [4, 2, 2]),
    ([4, 3, 3], [4, 3, 3]),
    ([2, 2, 2, 2], [3, 3, 1, 1]),
    ([30, 2], [31, 1]),
    ([32, 32], [32, 32]),
    ([60, 2, 2], [59, 3, 2]),
    ([38, 1, 1], [20, 20]),
    ([20, 14, 6], [25, 10, 5]),
    ([90, 60], [100, 50]),
    ([600, 500], [1_000, 100]),
]


def x_ln_x(n):
    return n * log(n) if n else mpf(0)


def tables(rows, columns):
    """All tables with these margins, as tuples of rows."""
    if len(rows) == 1:
        yield (tuple(columns),)
        return

    def fill(left, room):
        if len(room) == 1:
            if left <= room[0]:
                yield (left,)
            return
        for n in range(min(left, room[0]) + 1):
            for rest in fill(left - n, room[1:]):
                yield (n, *rest)

    for row in fill(rows[0], columns):
        for rest in tables(rows[1:], [c - n for c, n in zip(columns, row)]):
            yield (row, *rest)


def statistic(table, rows, columns):
    total = sum(rows)
    cells = sum(x_ln_x(n) for row in table for n in row)
    return x_ln_x(total) - sum(map(x_ln_x, rows)) - sum(map(x_ln_x, columns)) + cells


def square(table, rows, columns):
    total = sum(rows)
    return sum(
        Fraction((n * total - r * c) ** 2, total * r * c)
        for row, r in zip(table, rows)
        for n, c in zip(row, columns)
    )


MOMENTS = {}


def moments(rows, columns):
    """Mean and variance of T, and of X^2, over all tables."""
    key = (tuple(sorted(rows)), tuple(sorted(columns)))
    if key not in MOMENTS:
        ts, xs, weights = [], [], []
        for table in tables(rows, columns):
            product = 1
            for row in table:
                for n in row:
                    product *= int(factorial(n))
            weights.append(Fraction(1, product))
            ts.append(statistic(table, rows, columns))
            xs.append(square(table, rows, columns))
        whole = sum(weights)
        shares = [weight / whole for weight in weights]
        real = [mpf(share.numerator) / share.denominator for share in shares]
        mean = sum(p * t for p, t in zip(real, ts))
        variance = sum(p * (t - mean) ** 2 for p, t in zip(real, ts))
        x_mean = sum(p * x for p, x in zip(shares, xs))
        x_variance = sum(p * (x - x_mean) ** 2 for p, x in zip(shares, xs))
        MOMENTS[key] = mean, variance, x_mean, x_variance
    return MOMENTS[key]


def occupied(counts):
    rows = [row for row in counts if sum(row)]
    kept = [j for j in range(len(counts[0])) if any(row[j] for row in rows)]
    table = [[row[j] for j in kept] for row in rows]
    return table, [sum(row) for row in table], [sum(column) for column in zip(*table)]


def real(fraction):
    return mpf(fraction.numerator) / fraction.denominator


def same_pattern(strata, shape):
    """Q = d' V^- d and the rank of V, without the last row and column of the alphabet."""
    free = [(i, j) for i in range(shape[0] - 1) for j in range(shape[1] - 1)]
    d = [Fraction(0)] * len(free)
    v = [[Fraction(0)] * len(free) for _ in free]
    for stratum in strata:
        counts = stratum["counts"]
        r, c = [sum(row) for row in counts], [sum(column) for column in zip(*counts)]
        n = sum(r)
        if n < 2:
            continue
        for at, (i, j) in enumerate(free):
            d[at] += counts[i][j] - Fraction(r[i] * c[j], n)
            for other, (k, l) in enumerate(free):
                a = n * r[i] * (i == k) - r[i] * r[k]
                b = n * c[j] * (j == l) - c[j] * c[l]
                v[at][other] += Fraction(a * b, n * n * (n - 1))
    rank, form = 0, Fraction(0)
    rest = list(range(len(free)))
    while rest:
        pivot = max(rest, key=lambda at: v[at][at])
        if v[pivot][pivot] == 0:
            break
        rest.remove(pivot)
        form += d[pivot] ** 2 / v[pivot][pivot]
        rank += 1
        for at in rest:
            share = v[at][pivot] / v[pivot][pivot]
            d[at] -= share * d[pivot]
            for other in rest:
                v[at][other] -= share * v[pivot][other]
    assert all(d[at] == 0 for at in rest), "d lies in the range of V"
    return real(form), rank


def t_quantile(freedom):
    """The .975 quantile of Student's t, from the incomplete beta function."""
    def tail(t):
        return mpmath.betainc(freedom / 2, mpf(1) / 2, 0, freedom / (freedom + t * t), regularized=True) - mpf(1) / 20

    guess = mpf(float(scipy.stats.t.ppf(0.975, float(freedom))))
    return mpmath.findroot(tail, guess)


def references(strata, shape):
    t = m = v = above = below = null = mpf(0)
    visits, clusters = 0, {"state": {}, "segment": {}}
    for stratum in strata:
        table, rows, columns = occupied(stratum["counts"])
        n = sum(rows)
        visits += n
        y = x = mpf(0)
        if len(rows) > 1 and len(columns) > 1:
            mean, variance, x_mean, x_variance = moments(rows, columns)
            t, m, v = t + statistic(table, rows, columns), m + mean, v + variance
            kappa = min(1, x_variance / (2 * (len(rows) - 1) * (len(columns) - 1)))
            y, x = real(square(table, rows, columns) - x_mean) / 2, n * real(Fraction(kappa))
            null += real(x_variance) / 4
        above, below = above + y, below + x
        for by, sums in clusters.items():
            one = sums.setdefault(stratum[by], [mpf(0), mpf(0)])
            one[0], one[1] = one[0] + y, one[1] + x
    size = above / below

    def deviation(by):
        return sqrt(sum((y - size * x) ** 2 for y, x in clusters[by].values())) / below

    normal = mpmath.findroot(lambda z: mpmath.ncdf(z) - mpf(975) / 1000, mpf("1.96"))
    half = normal * max(sqrt(null) / below, deviation("state"))
    segments = [x / below for _, x in clusters["segment"].values()]
    new = None
    if sum(u > 0 for u in segments) >= 3:
        freedom = 1 / sum(u * u for u in segments) - 1
        wide = max(half, t_quantile(freedom) * deviation("segment"))
        new = [size - wide, size + wide]
    q, rank = same_pattern(strata, shape)
    answer = {
        "visits": visits,
        "statistic": t,
        "mean": m,
        "variance": v,
        "p_gamma": gammainc(m * m / v, t * m / v, regularized=True),
        "pattern": q,
        "rank": rank,
        "p_pattern": gammainc(mpf(rank) / 2, q / 2, regularized=True),
        "size": size,
        "effective_visits": below,
        "interval": [size - half, size + half],
        "interval_new_segments": new,
    }
    if shape == [2, 2]:
        tables_2x2 = [numpy.array(s["counts"]) for s in strata]
        peer = StratifiedTable(tables_2x2).test_null_odds(correction=False)
        assert abs(peer.statistic - q) < 1e-9 * q
    assert abs(scipy.stats.chi2.sf(float(q), rank) / answer["p_pattern"] - 1) < 1e-9
    return answer


def pool(seed, shape, strata, segments, visits, dependent):
    """Random strata; with a probability `dependent` the column copies the row."""
    rng = random.Random(seed)
    made = []
    for at in range(strata):
        counts = [[0] * shape[1] for _ in range(shape[0])]
        habit = rng.randrange(shape[0])
        for _ in range(rng.randint(*visits)):
            i = habit if rng.random() < 0.4 else rng.randrange(shape[0])
            j = i % shape[1] if rng.random() < dependent else rng.randrange(shape[1])
            counts[i][j] += 1
        made.append({"state": at // segments, "segment": at % segments, "counts": counts})
    return made


POOLS = [
    (1, [2, 2], 12, 3, (3, 9), 0.3),
    (2, [3, 3], 20, 4, (2, 8), 0.2),
    (3, [4, 3], 15, 5, (4, 9), 0.0),
    (4, [6, 6], 30, 6, (2, 5), 0.4),
    (5, [3, 4], 8, 2, (5, 10), 0.5),
]


def written(value):
    if isinstance(value, mpf):
        return float(mpmath.nstr(value, 20))
    if isinstance(value, list):
        return [written(one) for one in value]
    if isinstance(value, dict):
        return {name: written(one) for name, one in value.items()}
    return value


def main():
    margins = []
    for rows, columns in MARGINS:
        mean, variance, x_mean, x_variance = moments(rows, columns)
        margins.append(
            {
                "rows": rows,
                "columns": columns,
                "mean": mean,
                "variance": variance,
                "square_mean": real(x_mean),
                "square_variance": real(x_variance),
            }
        )
    pools = []
    for seed, shape, *rest in POOLS:
        strata = pool(seed, shape, *rest)
        pools.append({"shape": shape, "strata": strata, "reference": references(strata, shape)})
    meta = {
        "by": "pooled.py",
        "python": platform.python_version(),
        "mpmath": mpmath.__version__,
        "scipy": scipy.__version__,
        "statsmodels": statsmodels.__version__,
    }
    text = json.dumps(written({"meta": meta, "margins": margins, "pools": pools}), indent=1)
    Path(__file__).with_name("pooled.json").write_text(text + "\n")


if __name__ == "__main__":
    main()
