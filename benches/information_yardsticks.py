"""Times Python's figures of 6 x 6 tables, in nanoseconds a table, for benches/information.rs.

Needs `pip install numpy scikit-learn`, and `ndd` where a Fortran compiler lets it be installed; without ndd its line is
left out. `python information_yardsticks.py COUNTS`, COUNTS a file of little-endian uint32, 36 for each table. Prints
a line for each yardstick: our figure, the yardstick with its version, nanoseconds, with tabs between.
"""

import os

os.environ["OMP_NUM_THREADS"] = "1"

import sys
from statistics import median
from time import perf_counter_ns

import numpy
import sklearn
from sklearn.metrics import adjusted_mutual_info_score, mutual_info_score
from sklearn.metrics.cluster import contingency_matrix, expected_mutual_information

ROUNDS = 7
FEW = 500


def with_logarithms(tables):
    """(T(N) + T(cells) - T(rows) - T(columns)) / N of all tables at once, T(x) = sum x ln x."""
    return information(tables, lambda counts: counts * numpy.log(numpy.maximum(counts, 1)))


X_LN_X = numpy.arange(1001) * numpy.log(numpy.maximum(numpy.arange(1001), 1))


def tabulated(tables):
    """The same, x ln x looked up, as we do."""
    return information(tables, lambda counts: X_LN_X[counts])


def information(tables, x_ln_x):
    rows = tables.sum(axis=2)
    total = rows.sum(axis=1)
    sums = x_ln_x(rows).sum(axis=1) + x_ln_x(tables.sum(axis=1)).sum(axis=1)
    return (x_ln_x(total) + x_ln_x(tables.reshape(len(tables), -1)).sum(axis=1) - sums) / total


def nanoseconds(tables, run):
    times = []
    for _ in range(ROUNDS):
        started = perf_counter_ns()
        run(tables)
        times.append((perf_counter_ns() - started) / len(tables))
    return median(times)


def one_by_one(figure):
    return lambda tables: [figure(table) for table in tables]


def labels(table):
    rows, columns = numpy.indices(table.shape)
    return numpy.repeat(rows.ravel(), table.ravel()), numpy.repeat(columns.ravel(), table.ravel())


def main():
    tables = numpy.fromfile(sys.argv[1], dtype="<u4").reshape(-1, 6, 6).astype(numpy.int64)
    few = tables[:FEW]
    learn = f"scikit-learn {sklearn.__version__}"

    def tell(figure, yardstick, time):
        print(figure, yardstick, f"{time:.0f}", sep="\t")

    numbers = f"numpy {numpy.__version__} vectorised"
    tell("plug_in_dense", f"{numbers}, logarithms", nanoseconds(tables.astype(float), with_logarithms))
    tell("plug_in_dense", f"{numbers}, tabulated", nanoseconds(tables, tabulated))
    of_table = one_by_one(lambda table: mutual_info_score(None, None, contingency=table))
    tell("plug_in", f"{learn} mutual_info_score", nanoseconds(few, of_table))
    visits = [labels(table) for table in few]
    matrices = [contingency_matrix(*pair, sparse=True).astype(numpy.int64) for pair in visits]
    expected = one_by_one(lambda matrix: expected_mutual_information(matrix, int(matrix.sum())))
    tell("expected_if_independent", f"{learn} expected_mutual_information", nanoseconds(matrices, expected))
    adjusted = one_by_one(lambda pair: adjusted_mutual_info_score(*pair))
    tell("adjusted", f"{learn} adjusted_mutual_info_score", nanoseconds(visits, adjusted))
    try:
        import ndd
    except ImportError:
        return

    def nsb(table):
        rows, columns = table.sum(axis=1), table.sum(axis=0)
        return ndd.entropy(rows, k=6) + ndd.entropy(columns, k=6) - ndd.entropy(table.ravel(), k=36)

    tell("nsb", f"ndd {ndd.__version__}", nanoseconds(few, one_by_one(nsb)))


if __name__ == "__main__":
    main()
