"""Addresses of Dask schedulers, as Dask prints them.

TLS uses the certificates of its own configuration.
"""

import re
import shutil
import subprocess

import pytest

from meshes.base.errors import InputError
from tissue.system.workers import executor

SUBJECT = ("-subj", "/CN=localhost", "-addext", "subjectAltName=IP:127.0.0.1")


@pytest.fixture
def dask_config():
    """Dask's configuration, without certificates of this machine."""
    pytest.importorskip(
        "distributed", reason="distributed is not installed: pip install 'tissue-sim[cluster]'"
    )
    import dask.config

    with dask.config.set({"distributed.comm.tls.ca-file": None}):
        yield dask.config


@pytest.mark.parametrize("address", ["", "node:8786", "ssh://node:22", "tls://", "TCP://node:8786"])
def test_an_address_that_dask_does_not_print_is_refused(address):
    message = (
        "scheduler must be the address that Dask prints, tcp://HOST:PORT or tls://HOST:PORT, "
        f"got {address}: use"
    )
    with pytest.raises(InputError, match=re.escape(message)), executor(1, address, patience_s=0.2):
        pass


def test_tls_without_certificates_names_what_to_set(dask_config, tmp_path):
    with (
        pytest.raises(
            InputError, match=r"DASK_DISTRIBUTED__COMM__TLS__CA_FILE must name a file .* got none"
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
            match=r"DASK_DISTRIBUTED__COMM__TLS__CLIENT__CERT must name .*none, which is no file",
        ),
        executor(1, "tls://127.0.0.1:9", patience_s=0.2),
    ):
        pass


@pytest.mark.slow
@pytest.mark.skipif(
    shutil.which("openssl") is None, reason="openssl is not installed, which makes certificates"
)
def test_a_scheduler_with_tls_works_for_who_has_its_certificates_and_for_nobody_else(
    dask_config, tmp_path
):
    """One certificate that signs itself serves as authority, scheduler, worker and client."""
    import distributed

    ours, theirs = (certificate(tmp_path, name) for name in ("ours", "theirs"))
    roles = {
        f"tls_{role}_{part}": ours[part]
        for role in ("scheduler", "worker", "client")
        for part in ("cert", "key")
    }
    security = distributed.Security(tls_ca_file=ours["cert"], require_encryption=True, **roles)
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=None, security=security, protocol="tls"
    ) as cluster:
        address = cluster.scheduler_address
        assert address.startswith("tls://")
        with dask_config.set(tls_of(ours)), executor(1, address, patience_s=30.0) as pool:
            assert pool.submit(abs, -3).result(timeout=60.0) == 3
        for settings, at in ((tls_of(theirs), address), ({}, address.replace("tls://", "tcp://"))):
            with (
                dask_config.set(settings),
                pytest.raises(ConnectionError, match="no Dask scheduler answers at"),
                executor(1, at, patience_s=2.0),
            ):
                pass


def certificate(folder, name):
    """A key and a certificate that it signs itself."""
    files = {"cert": str(folder / f"{name}.pem"), "key": str(folder / f"{name}.key")}
    command = ("openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", *SUBJECT)
    subprocess.run(
        (*command, "-out", files["cert"], "-keyout", files["key"]), check=True, capture_output=True
    )
    return files


def tls_of(files):
    """Dask's settings for a client with these files."""
    names = {"ca-file": files["cert"], "client.cert": files["cert"], "client.key": files["key"]}
    return {f"distributed.comm.tls.{name}": file for name, file in names.items()}
