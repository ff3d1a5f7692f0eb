"""Prints the reference values of crates/nudge-core/src/evidence/expected_response/tests.rs, as Rust.

Needs mpmath (`pip install mpmath`; written with 1.4.1 on Python 3.11). Run as it is: `python bayes_factors.py`. It
takes some seconds. Written from the formulas at the top of expected_response.rs, with mpmath's own gamma, digamma
and incomplete beta functions at 40 digits; nothing of it is shared with the code under test.

Two environments, one of 2 x 3 and one of 3 x 2 actions, each with six kinds of states: among them one without
observations, one in which what was expected to be certain happened and one in which it did not. Every kind occurs as
often as `times` says, for weights are fitted over all states.
"""

from mpmath import betainc, digamma, exp, log, loggamma, mp, mpf

mp.dps = 40

NULLS = [mpf(x) for x in ("0.6", "1", "3", "6", "12", "25", "50", "100")]
SLABS = [(mpf(gamma), mpf(k)) for gamma in (1, 2) for k in (3, 12, 50)]
KAPPAS = [mpf(x) for x in (1, 2, 4, 8, 16, 32, 64, 128, 512, 2048)]
RAREST, TINY, LEAST = mpf("1e-4"), mpf("1e-12"), mpf("0.05")
ROUNDS = 60


def rising(a, n):
    """ln Gamma(a + n) - ln Gamma(a)."""
    return loggamma(a + n) - loggamma(a)


def scaled(values):
    total = sum(values)
    return [value / total for value in values]


def dirichlet_multinomial(counts, parameters):
    """ln DM of a sequence with these counts."""
    cells = sum(rising(a, n) for n, a in zip(counts, parameters))
    return cells - rising(sum(parameters), sum(counts))


def mean_and_variance(counts, ego, z, k, kappa):
    rows, columns = len(counts), len(counts[0])
    r = [sum(row) for row in counts]
    s = sum(r) + kappa
    p = [(r[i] + kappa * ego[i]) / s for i in range(rows)]
    square = [x * x + x * (1 - x) / (s + 1) for x in p]
    a = [[counts[i][j] + k * z[i][j] for j in range(columns)] for i in range(rows)]
    total = [r[i] + k for i in range(rows)]
    rho = [[x / total[i] for x in a[i]] for i in range(rows)]
    q = [sum(p[i] * rho[i][j] for i in range(rows)) for j in range(columns)]
    of_rows = sum(
        p[i] * (digamma(total[i] + 1) - sum(rho[i][j] * digamma(a[i][j] + 1) for j in range(columns)))
        for i in range(rows)
    )
    marginal = mpf(0)
    for j in range(columns):
        v = sum(square[i] * rho[i][j] * (1 - rho[i][j]) / (total[i] + 1) for i in range(rows))
        v += (sum(p[i] * rho[i][j] ** 2 for i in range(rows)) - q[j] ** 2) / (s + 1)
        c = q[j] * (1 - q[j]) / v - 1
        marginal -= q[j] * (digamma(q[j] * c + 1) - digamma(c + 1))
    mean = marginal - of_rows
    ratio = [[log(rho[i][j] / q[j]) for j in range(columns)] for i in range(rows)]
    first = [sum(rho[i][j] * ratio[i][j] for j in range(columns)) for i in range(rows)]
    second = [sum(rho[i][j] * ratio[i][j] ** 2 for j in range(columns)) for i in range(rows)]
    m = sum(p[i] * first[i] for i in range(rows))
    variance = sum(square[i] * (second[i] - first[i] ** 2) / (total[i] + 1) for i in range(rows))
    variance += (sum(p[i] * first[i] ** 2 for i in range(rows)) - m**2) / (s + 1)
    effective = (1 / sum(x * x for x in p) - 1) * (1 / sum(x * x for x in q) - 1)
    return mean, variance + 2 * (mean - m) ** 2 / effective


def tail(counts, ego, z, k, kappa, threshold):
    """P(MI > threshold) by the Beta distribution of that mean and variance, as far as one can have them."""
    largest = log(min(len(counts), len(counts[0])))
    mean, variance = mean_and_variance(counts, ego, z, k, kappa)
    mean, variance = min(max(mean / largest, mpf("1e-6")), 1 - mpf("1e-6")), variance / largest**2
    sharpness = max(mean * (1 - mean) / variance - 1, mpf("1e-3"))
    return 1 - betainc(mean * sharpness, (1 - mean) * sharpness, 0, threshold / largest, regularized=True)


def floored(values):
    return scaled([max(value, RAREST) for value in scaled(values)])


def terms(state, base, kappa, threshold):
    counts, ego, response = state
    rows, columns = len(counts), len(counts[0])
    m = [sum(ego[i] * response[i][j] for i in range(rows)) for j in range(columns)]
    sums = [sum(row[j] for row in counts) for j in range(columns)]
    bases = [base, [mpf(1) / columns] * columns, floored(m)]
    nulls = [dirichlet_multinomial(sums, [b * x for x in shares]) for shares in bases for b in NULLS]
    nothing = [[0] * columns for _ in range(rows)]
    slabs, before, after = [], [], []
    for gamma, k in SLABS:
        z = [floored([m[j] * (row[j] / m[j]) ** gamma for j in range(columns)]) for row in response]
        slabs.append(sum(dirichlet_multinomial(counts[i], [k * x for x in z[i]]) for i in range(rows)))
        before.append(tail(nothing, ego, z, k, kappa, threshold))
        after.append(tail(counts, ego, z, k, kappa, threshold))
    return nulls, slabs, before, after


def bayes_factors(kinds, base_counts, threshold):
    base = scaled([mpf(n) + mpf("0.5") for n in base_counts])
    states = [(state, times) for *state, times in kinds]

    def policy_likelihood(kappa):
        return sum(
            times * (sum(rising(kappa * p, sum(row)) for p, row in zip(ego, counts))
                     - rising(kappa, sum(map(sum, counts))))
            for (counts, ego, _), times in states
        )

    kappa = max(KAPPAS, key=policy_likelihood)
    kinds = [(terms(state, base, kappa, threshold), times) for state, times in states]
    pi, v, w = mpf("0.3"), [mpf(1) / 24] * 24, [mpf(1) / 6] * 6
    number = sum(times for _, times in kinds)
    for _ in range(ROUNDS):
        nulls, slabs, dependent = [mpf("0.1")] * 24, [mpf("0.1")] * 6, mpf(0)
        for (ln_nulls, ln_slabs, _, _), times in kinds:
            null = [(1 - pi) * weight * exp(ln) for weight, ln in zip(v, ln_nulls)]
            slab = [pi * weight * exp(ln) for weight, ln in zip(w, ln_slabs)]
            total = sum(null) + sum(slab)
            nulls = [x + times * y / total for x, y in zip(nulls, null)]
            slabs = [x + times * y / total for x, y in zip(slabs, slab)]
            dependent += times * sum(slab) / total
        pi = min(max((dependent + 3) / (number + 10), mpf("0.001")), mpf("0.999"))
        v, w = scaled(nulls), scaled(slabs)

    factors = []
    for (ln_nulls, ln_slabs, before, after), _ in kinds:
        slab = [weight * exp(ln) for weight, ln in zip(w, ln_slabs)]
        above = sum(x * (t + TINY) for x, t in zip(slab, after))
        above_prior = sum(x * (t + TINY) for x, t in zip(w, before))
        below = sum(x * (1 - t + TINY) for x, t in zip(slab, after))
        below_prior = sum(x * (1 - t + TINY) for x, t in zip(w, before))
        null = sum(weight * exp(ln) for weight, ln in zip(v, ln_nulls))
        otherwise = (1 - pi) * null + pi * below
        otherwise_prior = 1 - pi + pi * below_prior
        factors.append((above / max(above_prior, LEAST)) / (otherwise / max(otherwise_prior, LEAST)))
    return kappa, factors


def numbers(*texts):
    return [mpf(text) for text in texts]


EVEN_3 = [mpf(1) / 3] * 3

# Counts, the ego's expected policy, the expected responses, how many states are of the kind.
TWO_BY_THREE = [
    ([[6, 1, 0], [0, 2, 5]], numbers("0.5", "0.5"), [numbers("0.8", "0.1", "0.1"), numbers("0.1", "0.1", "0.8")], 7),
    ([[3, 2, 3], [2, 4, 2]], numbers("0.5", "0.5"), [numbers("0.8", "0.1", "0.1"), numbers("0.1", "0.1", "0.8")], 5),
    ([[4, 1, 9], [1, 0, 2]], numbers("0.75", "0.25"), [numbers("0.25", "0.25", "0.5"), numbers("0.5", "0.25", "0.25")], 4),
    ([[0, 0, 0], [0, 0, 0]], numbers("0.75", "0.25"), [numbers("0.25", "0.25", "0.5"), numbers("0.5", "0.25", "0.25")], 3),
    ([[5, 0, 0], [0, 0, 6]], numbers("0.25", "0.75"), [numbers("1", "0", "0"), numbers("0", "0.5", "0.5")], 2),
    ([[0, 7, 0], [0, 0, 4]], numbers("0.5", "0.5"), [numbers("1", "0", "0"), numbers("0", "0.5", "0.5")], 1),
]
THREE_BY_TWO = [
    ([[8, 0], [1, 6], [0, 9]], numbers("0.25", "0.25", "0.5"), [numbers("0.9", "0.1"), numbers("0.25", "0.75"), numbers("0.1", "0.9")], 3),
    ([[40, 41], [22, 18], [30, 33]], numbers("0.5", "0.25", "0.25"), [numbers("0.5", "0.5")] * 3, 6),
    ([[9, 1], [0, 0], [7, 2]], numbers("0.5", "0.25", "0.25"), [numbers("0.75", "0.25")] * 3, 4),
    ([[0, 5], [1, 1], [6, 0]], numbers("0.25", "0.25", "0.5"), [numbers("0.9", "0.1"), numbers("0.25", "0.75"), numbers("0.1", "0.9")], 2),
    ([[1, 0], [0, 0], [0, 0]], numbers("0.25", "0.25", "0.5"), [numbers("0.9", "0.1"), numbers("0.25", "0.75"), numbers("0.1", "0.9")], 5),
    ([[300, 20], [4, 90], [33, 31]], numbers("0.75", "0.125", "0.125"), [numbers("0.9", "0.1"), numbers("0.05", "0.95"), numbers("0.5", "0.5")], 1),
]

if __name__ == "__main__":
    for name, kinds, base, threshold in [
        ("TWO_BY_THREE", TWO_BY_THREE, [40, 25, 60], mpf("0.2")),
        ("THREE_BY_TWO", THREE_BY_TWO, [500, 300], mpf("0.3")),
    ]:
        kappa, factors = bayes_factors(kinds, base, threshold)
        print(name, "kappa", mp.nstr(kappa, 5), [mp.nstr(factor, 13) for factor in factors])
