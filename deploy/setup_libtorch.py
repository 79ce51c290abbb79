"""Puts libtorch under .torch/ of this checkout; called by deploy/setup, which has checked the machine.

What it leaves behind:

    .torch/torch-2.11.0/        what the build needs out of the fetched wheels; absent when LIBTORCH was given
    .torch/libtorch/            what .cargo/config.toml names
        lib/                    links to the shared libraries, and nothing else
        include                 link to torch's headers
        build-version           2.11.0

`lib` never shows libtorch_cuda.so, even where the torch it points to has it: torch-sys would then make every binary
depend on the whole of CUDA at start. The learner loads that library itself, at run time, where there is one.

Standard library only, Python 3.8 or newer.
"""

import contextlib
import errno
import fcntl
import hashlib
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path

# The release that the tch crate in Cargo.toml speaks. To move on: change tch, this, and the digests below.
TORCH_VERSION = "2.11.0"
TORCH_SERIES = "2.11"

# Of the processor that is built for.
MACHINE = sys.argv[1] if len(sys.argv) > 1 else os.uname().machine
IS_FOREIGN = MACHINE != os.uname().machine

# (requirement, platform tag, file name, bytes, SHA-256). libtorch_cpu.so of the ordinary wheel is linked against the
# two small CUDA libraries, with or without a GPU; nothing else of CUDA is needed to build or to run on a CPU.
ALL_WHEELS = [
    (
        "torch==2.11.0",
        "manylinux_2_28_x86_64",
        "torch-2.11.0-cp311-cp311-manylinux_2_28_x86_64.whl",
        530604548,
        "7aa2f9bbc6d4595ba72138026b2074be1233186150e9292865e04b7a63b8c67a",
    ),
    (
        "nvidia-cuda-runtime==13.0.96",
        "manylinux2014_x86_64",
        "nvidia_cuda_runtime-13.0.96-py3-none-manylinux2014_x86_64.manylinux_2_17_x86_64.whl",
        2243632,
        "7f82250d7782aa23b6cfe765ecc7db554bd3c2870c43f3d1821f1d18aebf0548",
    ),
    (
        "nvidia-cuda-cupti==13.0.85",
        "manylinux_2_25_x86_64",
        "nvidia_cuda_cupti-13.0.85-py3-none-manylinux_2_25_x86_64.whl",
        10715597,
        "4eb01c08e859bf924d222250d2e8f8b8ff6d3db4721288cf35d14252a4d933c8",
    ),
    (
        "torch==2.11.0",
        "manylinux_2_28_aarch64",
        "torch-2.11.0-cp311-cp311-manylinux_2_28_aarch64.whl",
        419718178,
        "d91aac77f24082809d2c5a93f52a5f085032740a1ebc9252a7b052ef5a4fddc6",
    ),
    (
        "nvidia-cuda-runtime==13.0.96",
        "manylinux2014_aarch64",
        "nvidia_cuda_runtime-13.0.96-py3-none-manylinux2014_aarch64.manylinux_2_17_aarch64.whl",
        2261060,
        "ef9bcbe90493a2b9d810e43d249adb3d02e98dd30200d86607d8d02687c43f55",
    ),
    (
        "nvidia-cuda-cupti==13.0.85",
        "manylinux_2_25_aarch64",
        "nvidia_cuda_cupti-13.0.85-py3-none-manylinux_2_25_aarch64.whl",
        10310827,
        "796bd679890ee55fb14a94629b698b6db54bcfd833d391d5e94017dd9d7d3151",
    ),
]
WHEELS = [wheel for wheel in ALL_WHEELS if wheel[1].endswith(MACHINE)]

# Everything else in the wheels (libtorch_cuda.so, Python code, tools) stays packed: 0.5 GB instead of 1.2 GB.
KEPT = re.compile(
    r"torch/lib/(libtorch_cpu\.so|libc10\.so|libgomp\.so\.1)$"
    # On ARM.
    r"|torch/lib/(libarm_compute\w*\.so|libgfortran\.so\.5|libnvpl_\w+\.so\.0)$"
    r"|torch/include/"
    r"|torch/version\.py$"
    r"|nvidia/cu13/lib/(libcudart\.so\.13|libcupti\.so\.13)$"
    r"|nvidia/cu13/include/"
    r"|[^/]+\.dist-info/licenses/"
)

# Linked by name from the torch in use; what else they need is found by asking the dynamic linker.
LINKED = ["libtorch_cpu.so", "libc10.so"]

SETUP_BYTES = 1_200_000_000  # the peak of a set-up (two copies of the big wheel), with room
BUILD_BYTES = 4_000_000_000  # target/ after a release build and the tests

ROOT = Path(__file__).resolve().parent.parent
# An unpacked release has programs instead of sources: nothing is compiled there.
IS_RELEASE = not (ROOT / "Cargo.toml").exists()
TORCH = ROOT / ".torch" / (MACHINE if IS_FOREIGN else "")
FETCHED = TORCH / f"torch-{TORCH_VERSION}"
LIBTORCH = TORCH / "libtorch"


class Failed(Exception):
    """One paragraph for the user: what is wrong and what to do."""


def say(text):
    print(f"setup: {text}", flush=True)


def megabytes(count):
    return f"{count / 1e6:.0f} MB" if count < 1e9 else f"{count / 1e9:.1f} GB"


# ---------------------------------------------------------------- what is there already


def version_of(torch):
    """The version of a libtorch folder or Python torch package, None where it does not say."""
    with contextlib.suppress(OSError):
        version = (torch / "build-version").read_text().strip()
        if version:
            return version
    with contextlib.suppress(OSError):
        match = re.search(r"^__version__\b.*?['\"]([^'\"]+)['\"]", (torch / "version.py").read_text(), re.MULTILINE)
        return match and match.group(1)
    return None


def fits(version):
    return re.match(rf"{re.escape(TORCH_SERIES)}\.\d+", version) is not None


def is_complete(libtorch):
    """Whether `libtorch` is a finished set-up whose links still lead to the right torch."""
    libraries = list((libtorch / "lib").glob("*.so*"))
    # An environment that was linked to may have been upgraded in place since.
    now = version_of(torch_in_use(libtorch))
    return (
        version_of(libtorch) == TORCH_VERSION
        and (now is None or fits(now))
        and all((libtorch / "lib" / name).exists() for name in [*LINKED, "libtorch.so"])
        and all(library.exists() for library in libraries)
        and (libtorch / "include/torch/csrc/api/include/torch/torch.h").exists()
    )


def torch_in_use(libtorch):
    """The folder of the torch that `libtorch` links to."""
    return (libtorch / "lib/libtorch_cpu.so").resolve().parent.parent


# ---------------------------------------------------------------- fetch


def check_disk():
    free = shutil.disk_usage(TORCH).free
    if IS_RELEASE and free >= SETUP_BYTES:
        return
    if free < SETUP_BYTES:
        raise Failed(
            f"only {megabytes(free)} are free on the file system of {ROOT}; set-up needs {megabytes(SETUP_BYTES)} (half"
            f" of it only while it runs) and the build another {megabytes(BUILD_BYTES)} for target/. Free some space,"
            " move the checkout, or point LIBTORCH at a torch 2.11 that is already on this machine."
        )
    if free < SETUP_BYTES + BUILD_BYTES:
        say(
            f"warning: {megabytes(free)} are free, enough for set-up, but a release build with its tests writes about"
            f" {megabytes(BUILD_BYTES)} to target/"
        )


def check_compiler():
    """Finds out before the long fetch whether C++ can be compiled: clang alone, for one, comes without a library."""
    compiler = shlex.split(os.environ.get("CXX", "c++"))
    tried = subprocess.run(
        [*compiler, "-std=c++17", "-fsyntax-only", "-x", "c++", "-"],
        input="#include <string>\nint main() { return std::string().size(); }\n",
        capture_output=True,
        text=True,
    )
    if tried.returncode != 0:
        said = (tried.stderr.strip().splitlines() or [f"exit status {tried.returncode}"])[0]
        raise Failed(
            f"'{' '.join(compiler)}' cannot compile two lines of C++17: {said!r}. Install a complete compiler"
            " (Debian, Ubuntu: apt-get install g++; Fedora, RHEL: dnf install gcc-c++), or set CXX to one."
        )


def pip_command():
    found = subprocess.run([sys.executable, "-m", "pip", "--version"], capture_output=True, text=True)
    if found.returncode != 0:
        raise Failed(
            f"{sys.executable} has no pip, which fetches libtorch from the Python package index (your index and proxy"
            " settings are respected). Install it (Debian, Ubuntu: apt-get install python3-pip; Fedora, RHEL: dnf"
            " install python3-pip), or set PYTHON to a Python 3 that has it, or point LIBTORCH at a torch 2.11 that is"
            " already on this machine."
        )
    return [sys.executable, "-m", "pip"]


def explain_pip(requirement, output):
    """The paragraph for a failed download, from what pip wrote."""
    lines = [line.strip() for line in output.splitlines() if re.match(r"\s*(ERROR|WARNING: Retrying)", line)]
    said = lines[-1][:400] if lines else (output.strip().splitlines() or ["nothing"])[-1][:400]
    network = (
        "NewConnectionError|ConnectTimeout|ReadTimeout|ConnectionResetError|ProxyError|SSLError|Name or service"
        "|name resolution|Connection refused|Network is unreachable|Max retries exceeded|Connection broken|timed out"
    )
    if "No space left on device" in output:
        return f"the disk became full while {requirement} was being fetched. Free some space and run it again."
    if "DO NOT MATCH THE HASHES" in output:
        reason = "what arrived does not match the index's own digest, so the transfer was damaged"
        advice = "Run it again; if that repeats, check the settings"
    elif re.search(network, output):
        # The cause stands at the heart of nested exceptions with addresses in them.
        causes = re.findall(r"\[Errno [^\]]*\] [^'\")]*|certificate verify failed[^'\")]*|\w*timed out\w*", output)
        said = (causes or [said])[0][:400]
        reason = "the Python package index cannot be reached"
        advice = "Check the network, and the proxy and certificate settings"
    elif re.search(r"\b(401|403|407)\b", output):
        reason = "the Python package index refused to serve it"
        advice = "Check the credentials and the index settings"
    elif "No matching distribution" in output or "Could not find a version" in output:
        reason = "the configured Python package index does not have it, or does not let you have it"
        advice = "Use an index that mirrors pypi.org: check the settings"
    else:
        reason = "pip failed"
        advice = "Check the settings"
    return (
        f"could not fetch {requirement}: {reason}. pip said: {said!r}. {advice} that pip uses"
        f" ('{Path(sys.executable).name} -m pip config list', PIP_INDEX_URL, HTTPS_PROXY) and run it again; or, on a"
        " machine without a network, point LIBTORCH at a torch 2.11 that is already there."
    )


def download(pip, requirement, platform, name, size, work):
    """Fetches one wheel into work/wheels, showing progress; returns its path."""
    wheels = work / "wheels"
    command = [
        *pip, "download", "--no-deps", "--no-cache-dir", "--disable-pip-version-check", "--no-input",
        "--dest", str(wheels), "--only-binary=:all:", "--python-version", "3.11", "--implementation", "cp",
        "--platform", platform, requirement,
    ]  # fmt: skip
    scratch = work / "pip"  # pip's own temporary files: /tmp may be a small RAM disk
    scratch.mkdir(exist_ok=True)
    log = work / "pip.log"
    with log.open("wb") as sink:
        pip_process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=sink,
            stderr=subprocess.STDOUT,
            env={**os.environ, "TMPDIR": str(scratch), "PIP_PROGRESS_BAR": "off"},
        )
        try:
            watch(pip_process, scratch, name, size)
        finally:
            if pip_process.poll() is None:
                pip_process.kill()
                pip_process.wait()
    if pip_process.returncode != 0:
        raise Failed(explain_pip(requirement, log.read_text(errors="replace")))
    wheel = wheels / name
    if not wheel.exists():
        others = ", ".join(sorted(file.name for file in wheels.glob("*"))) or "nothing"
        raise Failed(
            f"pip fetched {others} for {requirement}, not {name}: the configured package index is not a mirror of"
            f" pypi.org. See '{Path(sys.executable).name} -m pip config list' and PIP_INDEX_URL."
        )
    return wheel


def watch(process, scratch, name, size):
    """Waits for pip; on a terminal shows how much has arrived, elsewhere a line each ten seconds."""
    on_terminal = sys.stdout.isatty()
    last_line = time.monotonic()
    arrived = 0
    while True:
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(timeout=0.25 if on_terminal else 1)
            break
        for file in scratch.rglob("*.whl"):
            with contextlib.suppress(OSError):
                arrived = max(arrived, file.stat().st_size)
        if on_terminal:
            print(f"\rsetup:   {megabytes(arrived)} of {megabytes(size)} ", end="", flush=True)
        elif time.monotonic() - last_line > 10:
            last_line = time.monotonic()
            say(f"  {megabytes(arrived)} of {megabytes(size)}")
    if on_terminal:
        print("\r\033[K", end="", flush=True)


def verify(wheel, size, expected):
    digest = hashlib.sha256()
    with wheel.open("rb") as file:
        for block in iter(lambda: file.read(1 << 20), b""):
            digest.update(block)
    if digest.hexdigest() != expected:
        found_size = wheel.stat().st_size
        raise Failed(
            f"{wheel.name} is not the file this version of Stillroom was made with: its SHA-256 is"
            f" {digest.hexdigest()} ({found_size} bytes), expected {expected} ({size} bytes). It was deleted and"
            " nothing was installed. Run it again in case the transfer was damaged; if the digest stays wrong, the"
            " package index or a proxy between serves another file:"
            f" '{Path(sys.executable).name} -m pip config list' shows which are used."
        )


def unpack(wheel, site):
    """Unpacks what KEPT names; returns the bytes written."""
    written = 0
    with zipfile.ZipFile(wheel) as archive:
        for member in archive.infolist():
            if member.is_dir() or not KEPT.match(member.filename):
                continue
            target = Path(archive.extract(member, site))
            written += member.file_size
            if "/lib/" in member.filename:
                target.chmod(0o755)
                # On the disk before the rename that declares it complete: a power cut must not leave a torn library.
                with target.open("rb") as file:
                    os.fsync(file.fileno())
    return written


def fetch(work):
    """Fetches, verifies and unpacks the wheels; FETCHED exists afterwards, whole."""
    check_disk()
    pip = pip_command()
    start = time.monotonic()
    total = sum(wheel[3] for wheel in WHEELS)
    say(f"fetching libtorch {TORCH_VERSION} from the Python package index ({megabytes(total)})")
    site = work / "site"
    fetched = kept = 0
    for requirement, platform, name, size, digest in WHEELS:
        say(f"fetching {requirement} ({megabytes(size)})")
        wheel = download(pip, requirement, platform, name, size, work)
        verify(wheel, size, digest)
        fetched += wheel.stat().st_size
        kept += unpack(wheel, site)
        wheel.unlink()
    site.rename(FETCHED)
    seconds = time.monotonic() - start
    say(f"fetched {fetched} bytes ({megabytes(fetched)}), digests verified, {megabytes(kept)} kept, {seconds:.0f} s")


# ---------------------------------------------------------------- a torch that is there already


def given_torch(given):
    """The folder with lib/ and include/ that LIBTORCH names, after checking that it is torch 2.11."""
    # Not resolve(): a virtual environment may link its packages, and the linker looks beside the link.
    torch = Path(os.path.abspath(os.path.expanduser(given)))
    lacking = [
        part
        for part in ["lib/libtorch_cpu.so", "lib/libc10.so", "include/torch/csrc/api/include/torch/torch.h"]
        if not (torch / part).exists()
    ]
    if lacking:
        raise Failed(
            f"LIBTORCH={given} is neither a libtorch folder nor a Python torch package: {', '.join(lacking)}"
            f" {'is' if len(lacking) == 1 else 'are'} not there. Give the folder that holds lib/ and include/ (for a"
            " Python environment: python -c 'import torch; print(torch.__path__[0])'), or unset LIBTORCH and set-up"
            f" fetches torch {TORCH_VERSION}."
        )
    found = version_of(torch)
    if found is None or not fits(found):
        raise Failed(
            f"LIBTORCH={given} is torch {found or 'of an unknown version (no build-version, no version.py)'}; Stillroom"
            f" needs {TORCH_SERIES}. Point LIBTORCH at a torch {TORCH_SERIES} (pip install torch=={TORCH_VERSION}), or"
            f" unset it and set-up fetches torch {TORCH_VERSION}."
        )
    return torch, found


# ---------------------------------------------------------------- links


def needed_by(library, environment):
    """{name: path, or None where it is not found} of all that `library` needs, as the dynamic linker resolves it."""
    if IS_FOREIGN:
        # No linker of this machine reads it: all that was fetched.
        fetched = FETCHED.rglob("lib/*.so*")
        return {path.name: path for path in fetched}
    output = subprocess.run(["ldd", str(library)], capture_output=True, text=True, env=environment).stdout
    needed = {}
    for name, path in re.findall(r"^\s*(\S+) => (not found|/\S+)", output, re.MULTILINE):
        needed[name] = None if path == "not found" else Path(path)
    return needed


def link(torch, relative):
    """Makes the libtorch folder for `torch`, proves that it loads, and puts it in place."""
    # As deep as the final place, so that relative links are already right here.
    made = Path(tempfile.mkdtemp(prefix="tmp.", dir=TORCH))
    made.chmod(0o755)
    library_folder = made / "lib"
    library_folder.mkdir()

    def link_to(target, place):
        place.symlink_to(os.path.relpath(target, place.parent) if relative else target)

    for name in LINKED:
        link_to(torch / "lib" / name, library_folder / name)
    # tch asks for -ltorch; the real libtorch.so is an empty shell that pulls in CUDA.
    (library_folder / "libtorch.so").symlink_to("libtorch_cpu.so")
    link_to(torch / "include", made / "include")
    # What torch-sys compares with the version it wants. Patch releases of one series do not change the C++ interface.
    (made / "build-version").write_text(TORCH_VERSION + "\n")

    # The rest (OpenMP, the CUDA runtime, CUPTI) lies elsewhere in a wheel, in conda and in a libtorch archive. All
    # that is not the system's own is linked too, so that the folder needs no LD_LIBRARY_PATH and no rpath of torch's.
    system = ("/lib/", "/lib64/", "/usr/lib/", "/usr/lib64/")
    for name, path in needed_by(torch / "lib/libtorch_cpu.so", dict(os.environ)).items():
        if path is None:
            path = next(iter(sorted(torch.parent.glob(f"nvidia/*/lib/{name}"))), None)
        place = library_folder / name
        if path and not str(path).startswith(system) and not place.is_symlink():
            link_to(os.path.abspath(path), place)

    own = {name: value for name, value in os.environ.items() if name != "LD_LIBRARY_PATH"}
    missing = [name for name, path in needed_by(library_folder / "libtorch_cpu.so", own).items() if path is None]
    if missing:
        raise Failed(
            f"libtorch_cpu.so of {torch} needs {', '.join(missing)}, which is neither beside it nor among the system's"
            " libraries. Complete that torch (for the ordinary wheel: pip install nvidia-cuda-runtime==13.0.96"
            f" nvidia-cuda-cupti==13.0.85), or unset LIBTORCH and set-up fetches torch {TORCH_VERSION}."
        )
    load = f"import ctypes; ctypes.CDLL({str(library_folder / 'libtorch_cpu.so')!r}, ctypes.RTLD_GLOBAL)"
    proof = [sys.executable, "-c", "" if IS_FOREIGN else load]
    tried = subprocess.run(proof, capture_output=True, text=True, env=own)
    if tried.returncode != 0:
        said = (tried.stderr.strip().splitlines() or [f"exit status {tried.returncode}"])[-1]
        mend = f"run 'rm -rf {TORCH}' and set up again" if relative else "install that torch anew, or unset LIBTORCH"
        raise Failed(
            f"libtorch_cpu.so of {torch} does not load: {said!r}. If that names GLIBC or GLIBCXX, this torch was built"
            f" for a newer system; otherwise {mend}."
        )

    if LIBTORCH.is_symlink() or LIBTORCH.exists():
        LIBTORCH.rename(Path(tempfile.mkdtemp(prefix="tmp.", dir=TORCH)) / "replaced")
    made.rename(LIBTORCH)
    names = sorted(place.name for place in (LIBTORCH / "lib").iterdir())
    say(f"{LIBTORCH.relative_to(ROOT)} links to {torch.relative_to(ROOT) if relative else torch}: {', '.join(names)}")
    say("libtorch_cpu.so is of another processor" if IS_FOREIGN else "libtorch_cpu.so loads, no library is missing")


# ---------------------------------------------------------------- the whole


def remove_leftovers():
    """Deletes what an interrupted set-up left."""
    for path in TORCH.glob("tmp.*"):
        if path.is_symlink() or not path.is_dir():
            path.unlink()
        else:
            shutil.rmtree(path, ignore_errors=True)


@contextlib.contextmanager
def only_one():
    """Two set-ups of one checkout take turns. The lock goes with the process, however that ends."""
    with open(TORCH / "lock", "w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say("another set-up is at work in this checkout; waiting for it")
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


def set_up():
    given = "" if IS_FOREIGN else os.environ.get("LIBTORCH", "")
    torch = found = None
    # A shell that exports LIBTORCH=.../.torch/libtorch means what is set up here.
    if given and os.path.realpath(given) != os.path.realpath(LIBTORCH):
        torch, found = given_torch(given)

    def done():
        return is_complete(LIBTORCH) and (
            torch is None or torch_in_use(LIBTORCH) == (torch / "lib/libtorch_cpu.so").resolve().parent.parent
        )

    if done():
        say(f"nothing to do: {LIBTORCH.relative_to(ROOT)} is torch {TORCH_VERSION} at {torch_in_use(LIBTORCH)}")
        return
    TORCH.mkdir(parents=True, exist_ok=True)
    with only_one():
        if done():
            say("nothing left to do")
            return
        remove_leftovers()
        try:
            if not IS_RELEASE:
                check_compiler()
            if torch:
                say(f"using torch {found} at {torch} (LIBTORCH); nothing is fetched")
                link(torch, relative=False)
            else:
                if not FETCHED.exists():
                    work = Path(tempfile.mkdtemp(prefix="tmp.", dir=TORCH))
                    fetch(work)
                link(FETCHED / "torch", relative=True)
        finally:
            remove_leftovers()
    if IS_FOREIGN:
        return
    ready = "`./orchestrator doctor` says whether this machine is ready" if IS_RELEASE else "plain cargo commands work now"
    say(f"done; {ready}. `rm -rf .torch` undoes this")


def main():
    def interrupted(*_):
        raise KeyboardInterrupt

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, interrupted)
    try:
        set_up()
    except Failed as failure:
        sys.exit(f"setup: error: {failure}")
    except KeyboardInterrupt:
        print("\nsetup: interrupted; what was half done is deleted. Run it again to start anew", file=sys.stderr)
        sys.exit(130)
    except OSError as failure:
        advice = {
            errno.ENOSPC: f"the disk is full: set-up needs {megabytes(SETUP_BYTES)}. Free some space",
            errno.EDQUOT: "your disk quota is used up. Free some space",
            errno.EACCES: f"set-up writes to {TORCH} only. Make it and the checkout writable for this user",
            errno.EROFS: f"set-up writes to {TORCH} only. Use a checkout on a writable file system",
        }.get(failure.errno, f"'rm -rf {TORCH}' makes a fresh start possible")
        sys.exit(f"setup: error: {failure}: {advice} and run it again.")


if __name__ == "__main__":
    main()
