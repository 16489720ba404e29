"""Keys under which measurements are kept."""

from tissue.evaluation.charts import settings
from tissue.evaluation.charts.settings import sources


def test_a_change_of_any_file_of_the_code_makes_measurements_anew(tmp_path, monkeypatch):
    for package in settings.PACKAGES:
        (tmp_path / package / "inner").mkdir(parents=True)
    monkeypatch.setattr(settings, "files", lambda package: tmp_path / package)
    # not kept from one call to the next
    monkeypatch.setattr(settings, "code_sha256", settings.code_sha256.__wrapped__)
    (tmp_path / "kernels" / "__pycache__").mkdir()
    found = [sources()]
    for place, text in (
        ("tissue/inner/a.py", "a = 1"),
        ("tissue/inner/a.py", "a = 2"),
        ("kernels/b.toml", "b = 1"),
    ):
        (tmp_path / place).write_text(text)
        found.append(sources())
    assert len(set(found)) == len(found)
    (tmp_path / "kernels" / "__pycache__" / "b.pyc").write_bytes(b"compiled")
    assert sources() == found[-1]
