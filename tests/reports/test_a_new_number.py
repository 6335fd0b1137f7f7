import json
from typing import Annotated

import pytest

from bench.compare.publishing import published
from bench.records import fields, load_run, schema
from reports import table_text, write_report


@pytest.fixture
def described():
    caches = (fields.field_names, fields.shown_columns, fields._hints, fields._adapter)
    before = dict(schema.Job.__annotations__)

    def describe(**added):
        schema.Job.__annotations__.update(added)
        for cache in caches:
            cache.cache_clear()

    yield describe
    schema.Job.__annotations__.clear()
    describe(**before)


def test_a_measured_number_with_a_field_stands_in_table_page_and_published_results(made, described):
    described(sharpness=Annotated[schema.Number, schema.RESULTS, schema.Shown("sharpness", "% ↑", 4)])
    made.job(sharpness=61.84, file="files/a.nbtf")
    assert "sharpness % ↑" in (table := table_text(made.folder, "markdown", "main"))
    assert "61.84" in table
    write_report(made.folder)
    page = (made.folder / "report.html").read_text()
    assert "sharpness" in page
    assert "61.84" in page
    lines = map(json.loads, published(load_run(made.folder)).splitlines())
    assert [line["sharpness"] for line in lines if line["kind"] == "job"] == [61.84]


def test_a_field_is_checked_when_a_record_is_read(made, described):
    described(sharpness=schema.Positive)
    made.job(sharpness=-1.0)
    with pytest.raises(Exception, match=r"sharpness .*-1\.0"):
        list(load_run(made.folder).jobs)
