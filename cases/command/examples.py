"""Examples of every command, as its ``--help`` shows them; a test runs them."""

EXAMPLES: dict[str, tuple[str, ...]] = {
    "list": ("fpk list",),
    "new": ("fpk new pipe", "fpk new chain --masses 3 --law bilinear"),
    "check": ("fpk check fig6a",),
    "schema": ("fpk schema --out scene.schema.json",),
    "completion": (
        'eval "$(fpk completion bash)"                        # in ~/.bashrc; zsh: ~/.zshrc',
        "fpk completion fish > ~/.config/fish/completions/fpk.fish",
    ),
    "show": ("fpk show fig6a", "fpk show fig6a --json"),
    "run": ("fpk run fig6a --out out/fig6a", "fpk run fig6a --seconds 10 --seed 1 --json"),
    "density": (
        "fpk density fig6a --method nonintegrable --of q2 --at -1.5:1.5:0.1",
        'fpk density fig3a --method exact --of q2,p2 --at "-1:1:0.5 x 0,0.5" --json',
        "fpk density fig6a --method montecarlo --of H --at 0.1,0.2 --seconds 10",
    ),
    "transient": (
        "fpk transient fig6a --method nonintegrable --of H --times 1,10 --at 0:1:0.1",
        "fpk transient fig8a --method integrable --of H1 --start H1=0.1,H2=0.2 --times 5 --at 0.1",
    ),
    "passage": (
        "fpk passage fig6a --method nonintegrable --limit H=1 --times 10,100",
        "fpk passage fig6a --method montecarlo --limit q2=0.8 --times 10",
    ),
    "crossings": ("fpk crossings fig3a --method exact --of q2 --at 0:1:0.25",),
    "spectrum": ("fpk spectrum fig3a --method phase-space --of q2 --at 0:2:0.1",),
    "correlation": ("fpk correlation fig3a --method phase-space --of q2 --at 0:20:0.5",),
    "relaxation": (
        "fpk relaxation fig6a --method nonintegrable --rates 3",
        "fpk relaxation fig3a --method phase-space",
    ),
    "converge": ("fpk converge fig6b --route nonintegrable --out out/converge",),
    "cost": ("fpk cost fig6b --no-simulate --out out/cost",),
    "export": (
        "fpk export fig6a --out fig6a.nc",
        "fpk export fig7 --out fig7.vtu                       # for ParaView; .pvd for every curve",
    ),
    "sweep": (
        'fpk sweep fig6a --vary contact.clearance=0.3:1:8 --quantity "rms(q2)" --out out/sweep',
        'fpk sweep fig3a --vary system.noise_intensity=0.5,1,2 --quantity "upcrossing_rate(1)"'
        ' --quantity "correlation(q1,q2)" --method exact',
    ),
    "verify": ("fpk verify", "fpk verify fig6a fig8b --coarse"),
    "regime": (
        "fpk regime fig6a --vary contact.stiffness=0.01:1000:log5 --reference phase-space",
        "fpk regime fig6a --vary contact.stiffness=0.1:10:log5"
        " --vary contact.clearance=0.1:2:5 --out out/map",
    ),
}
"""Lines to type in a shell, by the name of the command."""
