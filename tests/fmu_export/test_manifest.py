"""The digest of the code that a Python FMU bundles."""

from fmu_export.manifest import code_digest


def test_digest_depends_on_the_names_and_contents_of_the_files_only():
    def digest(**files):
        return code_digest({f"{file.replace('__', '/')}.py": text.encode() for file, text in files.items()})

    one = digest(a="x = 1", sub__b="y = 2")
    assert digest(sub__b="y = 2", a="x = 1") == one
    others = [digest(a="x = 2", sub__b="y = 2"), digest(a="x = 1", sub__c="y = 2"), digest(a="x = 1", b="y = 2")]
    assert len({one, *others, digest(a="x = 1"), digest(a="y = 2", sub__b="x = 1")}) == 6
