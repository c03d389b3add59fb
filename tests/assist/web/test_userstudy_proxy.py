"""A user study behind nginx, which speaks TLS and fails for some seconds: nobody is lost, and no token is logged."""

from __future__ import annotations

import re
import runpy
import ssl
import subprocess
import sys
import time
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from urllib.parse import urljoin

import pytest
from conftest import ROOT
from networks import NGINX, conducted, free_port, proxy, running
from userstudies import PLAN, written

from assist.studies.userstudy import StudySession, read
from assist.web.app import make_app
from assist.web.request_limits import Allowance, networks
from assist.web.server import address, listen
from assist.web.tokens import VISITOR, AccessTokens
from assist.web.user_study.rehearsal import Rehearsal
from assist.web.user_study.routes import router
from assist.web.user_study.service import StudyService
from planner import Table

TOKEN = re.compile(r"[\w-]{32}")


@pytest.mark.skipif(NGINX is None, reason="nginx is not installed: `apt-get install nginx-light`")
@pytest.mark.slow
@pytest.mark.parametrize(("participants", "seconds"), [(3, 0.5), (24, 5.0)], ids=["3", "24"])
def test_a_study_completes_behind_a_proxy_that_fails_twice(
    tiny: Table, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, participants: int, seconds: float
) -> None:
    port = free_port()
    base = f"https://127.0.0.1:{port}/kits"
    text = PLAN.replace("seed = 3", f"seed = 3\nparticipants = {participants}")
    study, tasks = read(written(tmp_path / "study.toml", text)), {"tiny": tiny, "practice": tiny}
    session = StudySession(study, tasks, tmp_path / "data")
    access = AccessTokens.kept(tmp_path / "data" / "secret", base)
    service = StudyService(session, access, ticks=False, rehearsal=True)
    listening = listen("127.0.0.1", 0)
    monkeypatch.setenv("SSL_CERT_FILE", str(tmp_path / "cert.pem"))
    monkeypatch.setattr(urllib.request, "_opener", None)  # made anew, with this certificate

    behind = address(listening)
    app = make_app(
        service, allowance=Allowance(rate=1e6, burst=1e6), more=[router], trusted_proxies=networks(["127.0.0.1"])
    )
    with running(app, listening), proxy(tmp_path, port, behind), ThreadPoolExecutor(1) as threads:
        rehearsal = threads.submit(Rehearsal(participants).run, service, tasks, base)
        for events in (4, 12):
            while session.outlook().seq < events and not rehearsal.done():
                time.sleep(0.01)
            (tmp_path / "down").touch()
            time.sleep(seconds)
            (tmp_path / "down").unlink()
        rehearsal.result(200)
        overview = session.see(service._overview)
        done = [one for one in overview.participants if one.status == "done"]
        assert len(done) == participants
        assert [one.begun for one in overview.conditions] == pytest.approx([participants / 2] * 2, abs=0.5)

        # Links lead through the proxy, and the pages at them are complete.
        code = done[0].code
        trusted = ssl.create_default_context(cafile=str(tmp_path / "cert.pem"))
        for link in (service.join_url(), service.operator_url(), service.withdrawal_url(),
                     access.join_url(code).replace("/join/", "/part/")):  # fmt: skip
            assert link.startswith(f"{base}/")
            address_of_page = link.partition("#")[0]
            page = urllib.request.urlopen(address_of_page, context=trusted).read().decode()
            pieces = [piece for piece in re.findall(r'(?:src|href)="([^"]+)"', page) if not piece.startswith("data:")]
            assert len(pieces) >= 3
            for piece in pieces:
                assert urllib.request.urlopen(urljoin(address_of_page, piece), context=trusted).status == 200

    log = (tmp_path / "access.log").read_text()
    assert log.count(" 502 ") >= 2
    assert f"/kits/api/study/participants/{code}/onward" in log
    known = [access.operator, access.token(VISITOR), *(access.token(one.code) for one in overview.participants)]
    assert not [token for token in known if token in log]
    assert TOKEN.search(log) is None


@pytest.mark.slow
def test_the_example_of_the_documentation_takes_part_in_a_study(tiny: Table, tmp_path: Path) -> None:
    file = ROOT / "docs" / "examples" / "take_part.py"
    with conducted(tiny, tmp_path, PLAN.replace("seed = 3", "seed = 3\nparticipants = 1")) as service:
        last = runpy.run_path(str(file))["take_part"](service.join_url(), "a visitor")
        late = subprocess.run([sys.executable, file, service.join_url()], capture_output=True, text=True, timeout=60)
    assert (late.returncode, late.stderr.count("\n")) == (1, 1), late.stderr
    assert last["study"]["completion"]
    assert [one.status for one in service.session.see(service._overview).participants] == ["done"]
