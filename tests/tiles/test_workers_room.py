import pytest

_dask = pytest.importorskip("bumpytiles._dask", reason="needs distributed", exc_type=ImportError)


@pytest.mark.parametrize(("length", "fits"), [(75, True), (76, False)])
def test_workers_are_forked_only_where_the_address_of_their_socket_fits(monkeypatch, length, fits):
    """The system allows 107 bytes, of which "/pymp-12345678/listener-12345678" takes 32."""
    monkeypatch.setattr(_dask, "gettempdir", lambda: "/" + "x" * (length - 1))
    assert _dask._has_room_for_socket() is fits
