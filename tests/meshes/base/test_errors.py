"""Messages of errors for invalid inputs."""

import pickle

from meshes.base.errors import PRESENT, InputError, enumerated


def test_the_message_of_a_flag_does_not_print_its_value():
    error = InputError("web", "be left out with a movie", PRESENT, "leave it out")
    expected = "web must be left out with a movie. Leave it out"
    assert [str(error), str(pickle.loads(pickle.dumps(error)))] == [expected] * 2


def test_a_value_that_is_a_word_is_printed():
    error = InputError("region", "be a label", "it", "choose a label")
    assert str(error) == "region must be a label, got it. Choose a label"


def test_the_last_of_several_names_follows_a_word():
    assert enumerated(["a"]) == "a"
    assert enumerated(("a", "b"), "or") == "a or b"
    assert enumerated(iter([1, 2, 3])) == "1, 2 and 3"
