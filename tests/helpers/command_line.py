"""The command line, called in the process of the tests."""

import pytest

from pinconsist.cli import main


def called(capsys, *arguments, main=main):
    """Exit code, stdout and stderr of `pinconsist`, or another command line, with these arguments."""
    with pytest.raises(SystemExit) as end:
        main([str(each) for each in arguments])
    return end.value.code, *capsys.readouterr()
