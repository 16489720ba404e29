"""Study: the figures of an older study, printed next to the registered ones."""

import numpy as np
import pytest

from meshes.base.errors import InputError
from tissue.evaluation.statistics.trials import TrialTable
from tissue.evaluation.study.exploratory import exploratory_section, read_trials
from tissue.evaluation.study.plan import COMPARED


def trials(error, methods=("penalty", "koopman")):
    """Trials of T2 by three people, whose metrics are all `error` but for the person's share."""
    rng = np.random.default_rng(0)
    return TrialTable.from_rows(
        {"task": "T2", "group": "expert", "user": f"{user:02d}", "trial": user, "seed": user}
        | {"method": method}
        | dict.fromkeys(COMPARED, error * (1.0 + 0.1 * rng.random()))
        for user in range(3)
        for method in methods
    )


def test_an_older_table_is_read_bit_for_bit_and_printed_as_exploratory(tmp_path):
    old = trials(2.0, methods=("penalty", "kalman"))
    old.write_csv(tmp_path / "trials.csv")
    read = read_trials(tmp_path)
    for metric in COMPARED:
        assert (read.values(metric) == old.values(metric)).all()
    section = exploratory_section(trials(1.0), read, "first")
    assert "exploratory" in section.title
    assert "first is exploratory" in section.sentences[0]
    rows = {(row["method"], row["metric"]): row for row in section.table}
    assert len(rows) == 3 * len(COMPARED)
    both = rows["penalty", "force_error"]
    registered, exploratory = (
        float(both[name].split()[0]) for name in ("registered study", "exploratory, older study")
    )
    assert 1.0 < registered < 1.1 and 2.0 < exploratory < 2.2
    assert rows["koopman", "force_error"]["exploratory, older study"] == ""
    assert rows["kalman", "force_error"]["registered study"] == ""


def test_a_folder_without_a_table_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"trials.csv cannot be read as a table of trials"):
        read_trials(tmp_path)
    (tmp_path / "trials.csv").write_text("task,group\nT2,expert\n")
    with pytest.raises(InputError, match=r"trials.csv cannot be read as a table of trials"):
        read_trials(tmp_path)
