"""The figures of a comparison for people."""

from __future__ import annotations

from usdskin.judge.comparison.compare import Comparison

_STATISTICS = ("mean", "median", "p95", "max")


def print_comparison(found: Comparison) -> None:
    """Print the figures, with what they were taken under, on stdout."""
    from rich.console import Console
    from rich.table import Table

    console = Console(soft_wrap=True, highlight=False, markup=False)
    x, y = found.white
    pixels = int(found.mask.sum())
    console.print(f"{found.picture} against {found.truth}")
    console.print(f"mask   {found.mask_from}: {pixels} pixels, {found.mask.mean():.1%}")
    console.print(f"Y_n    {found.diffuser_xyz[1]:.6g}, from {found.white_from}")
    console.print(f"white  x {x:.5f} y {y:.5f}, {found.observer}")
    table = Table()
    table.add_column("", overflow="fold")
    for name in _STATISTICS:
        table.add_column(name, justify="right", no_wrap=True)
    rows = [("dE2000", "dE2000"), ("dE76", "dE76"), ("FLIP", "flip")]
    for title, name in rows:
        figures = found.statistics(name)
        table.add_row(title, *(f"{figures[key]:.3f}" for key in _STATISTICS))
    if found.regions:
        table.add_section()
        for region in found.regions:
            figures = region["deltaE2000"]
            label = f"dE2000 of {region['name']} ({region['pixels']})"
            table.add_row(label, *(f"{figures[key]:.3f}" for key in _STATISTICS))
    console.print(table)
    report = found.as_json()
    for title, key in (("dL*", "deltaL"), ("da*", "deltaA"), ("db*", "deltaB")):
        console.print(f"{title}    mean {report[key]['mean']:+.3f}, rms {report[key]['rms']:.3f}")
    if report["spectral"] is not None:
        figures = report["spectral"]
        console.print(
            f"spectra  GFC mean {figures['gfc']:.5f}, p05 {figures['p05gfc']:.5f}; "
            f"RMSE {figures['rmse']:.3%} of the peak ({figures['grid']})"
        )
