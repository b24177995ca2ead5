"""``croissant.json``: what a data set is, for search engines and loaders that read Croissant.

Croissant 1.0 (MLCommons, 2024) is JSON-LD of schema.org's vocabulary with three things added:
files and sets of files, *record sets*, and their fields.  One record set is written, ``samples``:
the rows of the index, a field each column, read from ``index.parquet``.  The shards are a set of
files.
"""

from __future__ import annotations

import json
from typing import Any

from slbench.datasets.manifest import Manifest
from slbench.datasets.store import index
from slbench.datasets.store.shards import digest
from slbench.datasets.store.storage import Storage

#: Name of the file in a data set.
CROISSANT = "croissant.json"
#: Data types by those of Arrow.
_TYPES = {"int64": "sc:Integer", "double": "sc:Float", "string": "sc:Text"}
#: The specification asks for this context as it stands, unused keys included.
_CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract",
    "field": "cr:field",
    "fileObject": "cr:fileObject",
    "fileProperty": "cr:fileProperty",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key",
    "md5": "cr:md5",
    "parentField": "cr:parentField",
    "path": "cr:path",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "recordSet": "cr:recordSet",
    "references": "cr:references",
    "regex": "cr:regex",
    "repeated": "cr:repeated",
    "replace": "cr:replace",
    "samplingRate": "cr:samplingRate",
    "sc": "https://schema.org/",
    "separator": "cr:separator",
    "source": "cr:source",
    "subField": "cr:subField",
    "transform": "cr:transform",
}


def write_croissant(url: str) -> None:
    """Write a data set's ``croissant.json``; its index must be there.

    Raises
    ------
    InputError
        If there is no data set, or no index.
    """
    storage = Storage(url)
    content = described(Manifest.load(storage), storage.read(index.INDEX))
    text = json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False)
    storage.write(CROISSANT, (text + "\n").encode())


def described(manifest: Manifest, rows: bytes) -> dict[str, Any]:
    """Return the description of a data set as Croissant 1.0 has it.

    Parameters
    ----------
    manifest : Manifest
    rows : bytes
        The index, as Parquet; its SHA-256 is stated.
    """
    fields = [
        {
            "@type": "cr:Field",
            "@id": f"samples/{name}",
            "name": name,
            "dataType": _TYPES[kind],
            "source": {"fileObject": {"@id": index.INDEX}, "extract": {"column": name}},
        }
        for name, kind in manifest.columns.items()
    ]
    files = [
        {
            "@type": "cr:FileObject",
            "@id": index.INDEX,
            "name": index.INDEX,
            "description": "One row a sample.",
            "contentUrl": index.INDEX,
            "encodingFormat": "application/x-parquet",
            "sha256": digest(rows),
        },
        {
            "@type": "cr:FileSet",
            "@id": "shards",
            "name": "shards",
            "description": "Samples in the WebDataset convention.",
            "encodingFormat": "application/x-tar",
            "includes": "shards/*.tar",
        },
    ]
    version = str(manifest.environment.get("slbench", "0"))
    return {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": manifest.name,
        "description": manifest.description or manifest.name,
        "license": manifest.licence,
        "citeAs": f"{manifest.name}, {manifest.count} samples, made with slbench {version}",
        "version": version,
        "keywords": ["structured light", "light transport", "depth", "synthetic"],
        "distribution": files,
        "recordSet": [
            {
                "@type": "cr:RecordSet",
                "@id": "samples",
                "name": "samples",
                "description": "The rows of the index.",
                "key": {"@id": "samples/key"},
                "field": fields,
            }
        ],
    }
