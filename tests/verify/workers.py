"""The same small campaign alone, in two processes, and on two workers of Dask: prints whether the reports are equal.

A program of its own, as Dask wants it: its workers start by importing the program that started them.
"""

from distributed import Client, LocalCluster
from servogen.verify.stress import stress

WHAT = {"systems": 20, "shapes": ((1, 2), (2, 3)), "families": ("dlatms spectra",), "scalars": ("float64",)}

if __name__ == "__main__":
    alone = stress(**WHAT)
    assert alone.passed
    assert stress(**WHAT, jobs=2) == alone
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        assert stress(**WHAT, executor=client.get_executor()) == alone
    print("equal")
