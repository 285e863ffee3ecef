"""Pages in headless Chromium: what a script has to say that is added to them."""

import json
import re
import subprocess
from base64 import b64encode
from hashlib import sha256
from html import unescape

RESULTS = """
const pre = document.createElement("pre");
pre.id = "results"; pre.textContent = JSON.stringify(out);
document.body.append(pre);
"""


def source_of(text):
    """The expression by which a content security policy allows a script or a style."""
    return f"'sha256-{b64encode(sha256(text.encode()).digest()).decode()}'"


def with_script(page, script):
    """The page with one more script, allowed by its hash."""
    page = page.replace("script-src ", f"script-src {source_of(script)} ", 1)
    return page.replace("</body>", f"<script>{script}</script></body>")


def shown(chromium, page, script, folder, *options):
    """What the script has to say when it is added to the page."""
    path = folder / "page.html"
    path.write_text(with_script(page, script), encoding="utf-8")
    command = [chromium, "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
               f"--user-data-dir={folder / 'profile'}", *options,
               "--dump-dom", path.as_uri()]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    (text,) = re.findall(r'<pre id="results">(.*?)</pre>', done.stdout, re.DOTALL)
    return json.loads(unescape(text))
