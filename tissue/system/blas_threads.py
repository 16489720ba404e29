"""Limit for the number of threads that libraries use for linear algebra."""

from contextlib import AbstractContextManager
from functools import lru_cache

from threadpoolctl import ThreadpoolController


def one_blas_thread() -> AbstractContextManager[object]:
    """Return a context manager in which NumPy and SciPy use one thread for linear algebra.

    If other programs also use the cores, threads that share a small matrix product wait for each
    other. The products then take ten times as long or more.
    """
    return _thread_pools().limit(limits=1, user_api="blas")


@lru_cache
def _thread_pools() -> ThreadpoolController:
    """Return the thread pools of NumPy and SciPy."""
    import scipy.linalg.lapack  # noqa: F401, loads SciPy's own pool

    return ThreadpoolController()
