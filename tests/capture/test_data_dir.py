"""The real photographs: skipped where nobody promised them, a failure where they were promised."""

from __future__ import annotations

import pytest


def test_real_photographs_are_skipped_only_where_nobody_promised_them(find_data, tmp_path):
    assert find_data({"LIGHTFACTOR_DATA": str(tmp_path), "CI": "true"}) == tmp_path
    with pytest.raises(pytest.skip.Exception, match="LIGHTFACTOR_DATA is not set"):
        find_data({})
    with pytest.raises(pytest.fail.Exception, match="continuous integration promises it"):
        find_data({"CI": "true"})
    with pytest.raises(pytest.fail.Exception, match="which is not a folder"):
        find_data({"LIGHTFACTOR_DATA": str(tmp_path / "nowhere")})
