"""Trips of UAH-DriveSet and what was planted in them."""

import pytest

from helpers import uah


@pytest.fixture(scope="session")
def made():
    return uah.make_trip


@pytest.fixture(scope="session")
def planted():
    return uah.PLANTED


@pytest.fixture(scope="session")
def truth():
    return uah.TRUTH
