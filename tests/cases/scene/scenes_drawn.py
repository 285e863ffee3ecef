"""Scenes that hypothesis draws: valid ones, and files that are nearly or not at all scenes."""

import json
from functools import cache

from hypothesis import strategies as st

from cases.scene.scene import shipped_scenes

NONSENSE = [
    "nan", "-inf", "inf", "1e400", "-1e308", "5e-324", "-0.0", "9" * 400, "-" + "9" * 400,
    "9" * 5000, "0x" + "f" * 500, "true", "false", '""', '"Left"', "'both'", '"\\u0000"',
    '"\\uD800"', "[]", "[[]]", "[[[1]]]", "{}", "{a = 1}", "[{}]", "[1, 'a']", "[nan]", "[[nan]]",
    "[1, [2]]", "1979-05-27", "07:32:00", "1979-05-27T07:32:00Z", "'../../etc/passwd'", "-1",
    "0", "1.5", '"""a\n"""', "[" * 40 + "]" * 40, "{a = " * 40 + "1" + "}" * 40, "=", "]", "\ufeff",
]  # fmt: skip
"""Values that no key takes, and some that one does."""


def numbers(low, high):
    """Positive numbers, equally likely on any scale from 10^low to 10^high, as TOML writes them."""
    return st.floats(low, high).map(lambda x: float(f"{10.0**x:.6g}"))


@st.composite
def valid_scenes(draw, units=0, spread=1, most_masses=3, most_touching=2, one_law=False):
    """The text of a scene that nothing can be wrong with: c and D diagonal and positive.

    Every quantity is ``spread`` powers of ten about one in some unit, mass, length and time being
    up to 10^``units`` of what the scene counts them in. Contacts are at ``most_touching`` masses,
    all of the same law with ``one_law``: each combination of laws is compiled by itself.
    """
    n = draw(st.integers(1, most_masses))
    m, x, t = (10.0 ** draw(st.integers(-units, units)) for _ in range(3))

    def number(unit):
        return numbers(-spread, spread).map(lambda value: value * unit)

    key_units = {
        "mass": m,
        "stiffness": m / t**2,
        "damping": m / t,
        "noise_intensity": m**2 * x**2 / t**3,
    }
    lines = [
        f"title = {json.dumps(draw(TITLES), ensure_ascii=False)}" if draw(st.booleans()) else "",
        "[system]",
        *(
            f"{key} = {draw(st.lists(number(unit), min_size=n, max_size=n))}"
            for key, unit in key_units.items()
        ),
    ]
    mass = draw(st.integers(1, n))
    laws = st.sampled_from([("hertz", 1.5), ("bilinear", 1.0), ("power", 2.5)])
    laws = st.just(draw(laws)) if one_law else laws
    for _ in range(draw(st.integers(0, 2))):
        mass = mass if most_touching == 1 else draw(st.integers(1, n))
        side = draw(st.sampled_from(["left", "right", "both"]))
        law, exponent = draw(laws)
        own = f"exponent = {exponent}" if law == "power" else ""
        force = m * x / t**2
        lines += [
            f'[[contact]]\nmass = {mass}\nside = "{side}"',
            f'law = "{law}"\n{own}\nstiffness = {draw(number(force / x**exponent))}',
            f"clearance = {draw(st.just(0.0) | number(x))}",
        ]
    single = [f"{kind}{i}" for kind in "qpH" for i in range(1, n + 1)] + ["H"]
    asked = draw(st.lists(st.sampled_from(single), min_size=1, max_size=3, unique=True))
    return "\n".join([*lines, f"[observe]\ndensities = {json.dumps(asked)}", ""])


TITLES = st.text(st.characters(exclude_categories=("Cs", "Cc", "Cn")), max_size=30)


@st.composite
def mutated_scenes(draw):
    """The bytes of a shipped scene in which lines, values, characters or bytes were changed."""
    lines = draw(st.sampled_from(shipped_texts())).splitlines()
    for _ in range(draw(st.integers(1, 3))):
        i = draw(st.integers(0, len(lines) - 1))
        j = draw(st.integers(0, len(lines) - 1))
        cut = draw(st.integers(0, len(lines[i])))
        match draw(st.sampled_from(["value", "key", "delete", "double", "swap", "cut", "insert"])):
            case "value":
                lines[i] = f"{lines[i].partition('=')[0]}= {draw(VALUES)}"
            case "key":
                lines[i] = f"{draw(KEYS)} = {lines[i].partition('=')[2] or draw(VALUES)}"
            case "delete":
                lines[i] = ""
            case "double":
                lines[i] += "\n" + lines[i]
            case "swap":
                lines[i], lines[j] = lines[j], lines[i]
            case "cut":
                lines[i] = lines[i][:cut]
            case "insert":
                lines[i] = lines[i][:cut] + draw(st.text(max_size=4)) + lines[i][cut:]
    content = "\n".join(lines).encode("utf-8", "surrogatepass")
    if draw(st.integers(0, 9)) == 0:
        i = draw(st.integers(0, len(content)))
        content = content[:i] + draw(st.binary(max_size=3)) + content[i + 1 :]
    return content


VALUES = st.one_of(
    st.sampled_from(NONSENSE),
    st.integers().map(str),
    st.floats().map(str),
    st.text(max_size=8).map(json.dumps),
    st.lists(st.floats(-10, 10), max_size=4).map(str),
)
KEYS = st.one_of(
    st.sampled_from(["mass", "side", "clearance", "contact.stiffness", "q", "v.1", "a.b", '""']),
    st.text(max_size=6).map(json.dumps),
)


@cache
def shipped_texts():
    """Return the texts of all shipped scenes."""
    texts = [path.read_text(encoding="utf-8") for path in shipped_scenes().values()]
    assert len(texts) >= 14
    return texts
