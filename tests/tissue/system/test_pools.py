"""Addresses of Dask schedulers, as Dask prints them.

TLS uses the certificates of its own configuration.
"""

import re

import pytest

from meshes.base.errors import InputError
from tissue.system.workers import executor


@pytest.fixture
def dask_config():
    """Dask's configuration, without certificates of this machine."""
    pytest.importorskip(
        "distributed", reason="distributed is not installed: pip install distributed"
    )
    import dask.config

    with dask.config.set({"distributed.comm.tls.ca-file": None}):
        yield dask.config


@pytest.mark.parametrize("address", ["", "node:8786", "ssh://node:22", "tls://", "TCP://node:8786"])
def test_an_address_that_dask_does_not_print_is_refused(address):
    message = (
        "scheduler must be the address that Dask prints, tcp://HOST:PORT or tls://HOST:PORT, "
        f"got {address or 'an empty value'}. Use"
    )
    with pytest.raises(InputError, match=re.escape(message)), executor(1, address, patience_s=0.2):
        pass


def test_tls_without_certificates_names_what_to_set(dask_config, tmp_path):
    with (
        pytest.raises(
            InputError,
            match=r"DASK_DISTRIBUTED__COMM__TLS__CA_FILE must be the path of a certificate file .* got none",
        ),
        executor(1, "tls://127.0.0.1:9", patience_s=0.2),
    ):
        pass
    there = tmp_path / "ca.pem"
    there.write_text("")
    missing = {
        "distributed.comm.tls.ca-file": str(there),
        "distributed.comm.tls.client.cert": str(tmp_path / "none"),
    }
    with (
        dask_config.set(missing),
        pytest.raises(
            InputError,
            match=r"DASK_DISTRIBUTED__COMM__TLS__CLIENT__CERT must be the path of .*none, which is not a file",
        ),
        executor(1, "tls://127.0.0.1:9", patience_s=0.2),
    ):
        pass
