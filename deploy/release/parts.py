"""What the programs are made of: a bill of materials in CycloneDX 1.5, and the licences of all of it as one text.

    python3 deploy/release/parts.py --bill FILE --licences FILE

Both follow from Cargo.lock and the sources that cargo has fetched. Standard library only, Python 3.8 or newer.
"""

import argparse
import hashlib
import json
import re
import subprocess
import sys
import uuid
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
# The programs, the library for simulators in other languages, and the module of the Python package.
PROGRAMS = ["orchestrator", "actor", "learner", "stillroom_actor", "python"]
LICENCE = re.compile(r"(LICEN[CS]E|COPYING|COPYRIGHT|NOTICE|UNLICENSE|OFL)", re.IGNORECASE)


def version():
    return re.search(r'^version = "(.*)"', (ROOT / "Cargo.toml").read_text(), re.MULTILINE).group(1)


def metadata():
    command = ["cargo", "metadata", "--locked", "--format-version", "1", "--filter-platform", "x86_64-unknown-linux-gnu"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"dist: error: cargo metadata: {done.stderr.strip()}")
    return json.loads(done.stdout)


def checksums():
    """SHA-256 of a package's archive by (name, version), as Cargo.lock has it."""
    found = {}
    for block in (ROOT / "Cargo.lock").read_text().split("[[package]]")[1:]:
        fields = dict(re.findall(r'^(name|version|checksum) = "(.*)"$', block, re.MULTILINE))
        found[fields["name"], fields["version"]] = fields.get("checksum")
    return found


def linked_into_programs(data):
    """{package id: ids of what it links}, for all that the programs and the Python module link: neither tests nor build scripts."""
    nodes = {node["id"]: node for node in data["resolve"]["nodes"]}
    packages = {package["id"]: package for package in data["packages"]}
    members = set(data["workspace_members"])
    waiting = [identity for identity in sorted(members) if packages[identity]["name"] in PROGRAMS]
    found = {}
    while waiting:
        identity = waiting.pop()
        if identity in found:
            continue
        links = []
        for dependency in nodes[identity]["deps"]:
            kinds = dependency["dep_kinds"]
            kinds_of_target = packages[dependency["pkg"]]["targets"]
            is_macro = any("proc-macro" in target["kind"] for target in kinds_of_target)
            if any(kind["kind"] is None for kind in kinds) and not is_macro:
                links.append(dependency["pkg"])
        found[identity] = sorted(links)
        waiting += links
    return found


def torch():
    """{(name, version): SHA-256 for each processor} of the wheels that set-up fetches."""
    text = (ROOT / "deploy/setup_libtorch.py").read_text()
    wheels = re.findall(r'"([a-z-]+)==([0-9.]+)",\s+"[^"]+",\s+"[^"]+",\s+\d+,\s+"([0-9a-f]{64})"', text)
    if len(wheels) != 6:
        sys.exit("dist: error: the wheels in deploy/setup_libtorch.py are not as deploy/release/parts.py reads them")
    return {wheel[:2]: [other[2] for other in wheels if other[:2] == wheel[:2]] for wheel in wheels}


def charts():
    """The chart library of the page, a copy in the checkout: version, SHA-256 of its script, licence."""
    folder = ROOT / "view/page/uPlot"
    digest = hashlib.sha256((folder / "uPlot.iife.min.js").read_bytes()).hexdigest()
    said = (folder / "README.md").read_text()
    if digest not in said:
        sys.exit(f"dist: error: {folder}/uPlot.iife.min.js is not the file that README.md beside it names")
    return re.search(r"^# uPlot ([0-9.]+)$", said, re.MULTILINE)[1], digest, (folder / "LICENSE").read_text().strip()


def component(package, checksum):
    made = {
        "type": "library",
        "bom-ref": f"pkg:cargo/{package['name']}@{package['version']}",
        "name": package["name"],
        "version": package["version"],
        "purl": f"pkg:cargo/{package['name']}@{package['version']}",
        "scope": "required",
    }
    if package.get("license"):
        # Cargo still accepts the slash of older manifests.
        made["licenses"] = [{"expression": package["license"].replace("/", " OR ")}]
    if checksum:
        made["hashes"] = [{"alg": "SHA-256", "content": checksum}]
    if package.get("repository"):
        made["externalReferences"] = [{"type": "vcs", "url": package["repository"]}]
    return made


def bill(data):
    packages = {package["id"]: package for package in data["packages"]}
    sums = checksums()
    linked = linked_into_programs(data)
    number = version()

    def reference(identity):
        return f"pkg:cargo/{packages[identity]['name']}@{packages[identity]['version']}"

    components = [
        component(packages[identity], sums.get((packages[identity]["name"], packages[identity]["version"])))
        for identity in sorted(linked, key=reference)
    ]
    for (name, torch_version), digests in torch().items():
        place = f"pkg:pypi/{name}@{torch_version}"
        components.append({
            "type": "library",
            "bom-ref": place,
            "name": name,
            "version": torch_version,
            "purl": place,
            "scope": "required",
            "description": "Not included: set-up or pip fetches this, or finds a torch that is there.",
            "hashes": [{"alg": "SHA-256", "content": digest} for digest in digests],
        })  # fmt: skip
    charts_version, digest, _ = charts()
    place = f"pkg:npm/uplot@{charts_version}"
    components.append({
        "type": "library",
        "bom-ref": place,
        "name": "uPlot",
        "version": charts_version,
        "purl": place,
        "scope": "required",
        "licenses": [{"expression": "MIT"}],
        "hashes": [{"alg": "SHA-256", "content": digest}],
    })  # fmt: skip
    dependencies = [
        {"ref": reference(identity), "dependsOn": [reference(to) for to in linked[identity]]}
        for identity in sorted(linked, key=reference)
    ]
    root = f"pkg:generic/stillroom@{number}"
    programs = [reference(identity) for identity in sorted(linked) if packages[identity]["name"] in PROGRAMS]
    dependencies.insert(0, {"ref": root, "dependsOn": sorted(programs)})
    body = json.dumps([components, dependencies], sort_keys=True)
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        # The same parts, the same number.
        "serialNumber": f"urn:uuid:{uuid.uuid5(uuid.NAMESPACE_URL, body)}",
        "version": 1,
        "metadata": {
            "component": {
                "type": "application",
                "bom-ref": root,
                "name": "stillroom",
                "version": number,
                "purl": root,
                "licenses": [{"expression": "MIT OR Apache-2.0"}],
            }
        },
        "components": components,
        "dependencies": dependencies,
    }


def licences(data):
    """The licence files of all that is linked and is not ours, each text once."""
    packages = {package["id"]: package for package in data["packages"]}
    members = set(data["workspace_members"])
    number, _, text = charts()
    texts, silent = {text: [f"uPlot {number} (MIT)"]}, []
    for identity in linked_into_programs(data):
        if identity in members:
            continue
        package = packages[identity]
        name = f"{package['name']} {package['version']} ({package.get('license') or 'see its licence file'})"
        folder = Path(package["manifest_path"]).parent
        files = sorted(path for path in folder.iterdir() if path.is_file() and LICENCE.match(path.name))
        for path in files:
            texts.setdefault(path.read_text(errors="replace").strip(), []).append(name)
        if not files:
            silent.append(name)
    parts = ["What the programs of Stillroom link, and its licences. Each text stands below the packages that have it.\n"]
    for text, names in sorted(texts.items(), key=lambda item: sorted(item[1])):
        parts.append("=" * 100 + "\n" + "\n".join(sorted(set(names))) + "\n" + "-" * 100 + f"\n{text}\n")
    if silent:
        parts.append("=" * 100 + "\nWithout a file of their own; the licence is the one named:\n")
        parts.append("\n".join(sorted(silent)) + "\n")
    return "\n".join(parts)


def write_bill(data, path):
    path.write_text(json.dumps(bill(data), indent=1) + "\n")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bill", type=Path)
    parser.add_argument("--licences", type=Path)
    arguments = parser.parse_args()
    data = metadata()
    if arguments.bill:
        write_bill(data, arguments.bill)
    if arguments.licences:
        arguments.licences.write_text(licences(data))


if __name__ == "__main__":
    main()
