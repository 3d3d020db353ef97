"""The style sheets of the pages."""


STYLE = """
:root { --ink: #1d1d1b; --soft: #66645f; --line: #dcd9d2; --grey: #757575; }
* { box-sizing: border-box; }
body { margin: 0; background: #fff; color: var(--ink);
  font: 15px/1.5 "Helvetica Neue", Helvetica, Arial, "Liberation Sans", sans-serif; }
main { max-width: 1000px; margin: 0 auto; padding: 28px 32px 64px; }
h1 { font-size: 30px; font-weight: 300; letter-spacing: -.01em; margin: 0 0 4px; overflow-wrap: anywhere; }
h2 { font-size: 19px; font-weight: 400; margin: 44px 0 6px; padding-top: 12px; border-top: 1px solid var(--line); }
p { max-width: 46em; margin: 6px 0 12px; }
.soft, figcaption, .note { color: var(--soft); }
.verdict { font-size: 18px; line-height: 1.45; margin: 18px 0 8px; max-width: 40em; }
.answers { margin-top: 14px; }
.answer h2 { font-size: 15px; font-weight: 600; margin: 0; padding: 0; border: 0; }
.answer p { margin: 3px 0; }
.answer .said { font-size: 18px; line-height: 1.4; max-width: none; }
.answer .note { font-size: 13px; max-width: none; }
.answers .four { margin: 12px 0 14px; }
.answers .plate { padding: 12px; } .answers .plate img { width: 100%; }
.grade { display: inline-block; font-size: 20px; font-weight: 600; color: #fff; background: #66645f;
  padding: 1px 12px 2px; border-radius: 4px; margin-right: 8px;
  print-color-adjust: exact; -webkit-print-color-adjust: exact; }
.grade.good { background: #2a7a43; } .grade.fair { background: #a06a00; } .grade.poor { background: #b3261e; }
.halves { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 8px 32px; }
.halves ol { margin: 3px 0; padding-left: 18px; } .halves li + li { margin-top: 6px; }
.alike { float: right; display: flex; gap: 6px; margin: 4px 0 4px 12px; }
.alike img { width: 40px; }
.swatch { display: inline-block; width: 12px; height: 12px; margin-right: 5px; vertical-align: -1px;
  outline: 1px solid var(--line); print-color-adjust: exact; -webkit-print-color-adjust: exact; }
figcaption .scale, figcaption .ends { margin-top: 3px; } figcaption .scale { display: block; height: 6px; }
h3 { font-size: 15px; font-weight: 600; margin: 20px 0 4px; }
code { font: 0.92em "SFMono-Regular", Menlo, Consolas, "Liberation Mono", monospace; overflow-wrap: anywhere; }
code span { white-space: nowrap; }
a { color: #1a5a96; }
.caution { border-left: 3px solid #c58a00; padding: 2px 0 2px 14px; margin: 10px 0; max-width: 48em; }
.caution ul, .caution p { margin: 4px 0; padding-left: 0; list-style: none; }
.caution li + li { margin-top: 6px; }
.row { display: flex; flex-wrap: wrap; gap: 16px; align-items: flex-start; }
section { overflow-x: auto; }
figure { margin: 0; }
.plate { background: var(--grey); padding: 16px; display: flex; justify-content: center; align-items: center;
  print-color-adjust: exact; -webkit-print-color-adjust: exact; }
.plate + figcaption { margin-top: 6px; font-size: 13px; line-height: 1.4; max-width: 272px; }
figcaption b { font-weight: 600; color: var(--ink); }
img { display: block; height: auto; max-width: 100%; }
img.large { width: 256px; }
img.middle { width: 192px; }
img.small { width: 112px; }
img.disc { border-radius: 50%; }
.three, .four { display: grid; grid-template-columns: repeat(3, minmax(0, 288px)); gap: 16px; }
.four { grid-template-columns: repeat(4, minmax(0, 1fr)); gap: 14px; }
.four .plate { aspect-ratio: 1; }
.below { margin-top: 22px; gap: 22px; } .below div { flex: 1; min-width: 260px; } .below figure { flex: none; }
@media (max-width: 640px) { .three, .four { grid-template-columns: repeat(2, minmax(0, 1fr)); }
  main { padding: 20px 16px 48px; } .halves { grid-template-columns: 1fr; } h1 { font-size: 24px; }
  .three > div { grid-column: 1 / -1; } }
.outlined { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 16px; align-items: start; }
@media (max-width: 640px) { .outlined { grid-template-columns: 1fr; } }
.row svg { max-width: 100%; height: auto; }
.under { position: relative; } .under img { width: 100%; min-width: 256px; }
.under svg { position: absolute; inset: 0; width: 100%; height: 100%; overflow: hidden; }
.under polygon { fill: none; stroke: #ffd400; stroke-width: 1.5; vector-effect: non-scaling-stroke; }
.polars figcaption { text-align: center; }
.polars { display: grid; grid-template-columns: 1fr 1fr; gap: 10px 24px; }
sub { line-height: 0; }
.four + .four { margin-top: 18px; }
.four + .note { margin-top: 18px; }
.scale { height: 10px; margin: 8px 0 2px; print-color-adjust: exact; -webkit-print-color-adjust: exact; }
.ends { display: flex; justify-content: space-between; font-size: 12px; color: var(--soft); }
table { border-collapse: collapse; font-size: 14px; }
th { font-weight: 400; color: var(--soft); text-align: left; vertical-align: bottom; font-size: 13px; }
th, td { padding: 5px 18px 5px 0; border-bottom: 1px solid var(--line); }
td { vertical-align: top; font-variant-numeric: tabular-nums; }
table.classes td { vertical-align: middle; }
table.classes td.shot { padding-right: 10px; }
table.classes .plate { padding: 8px; width: 128px; }
tr.found td { background: #f6f5f1; }
tr.won td:first-child { box-shadow: inset 3px 0 #2a8c4a; }
tr td:first-child, tr th:first-child { padding-left: 12px; }
.badge { display: inline-block; background: #2a8c4a; color: #fff; font-size: 12px; padding: 0 7px;
  border-radius: 9px; print-color-adjust: exact; -webkit-print-color-adjust: exact; }
.number { font-variant-numeric: tabular-nums; font-size: 13px; }
svg.bar { width: 110px; height: 11px; margin-right: 8px; vertical-align: -1px; }
svg.plan { width: 36px; height: 46px; float: right; margin: 2px 4px 0 8px; }
svg.polar { width: 100%; height: auto; }
svg.polar text { font-size: 6.5px; }
.slice { position: relative; }
.slice img { position: absolute; left: 13.889%; top: 2.778%; width: 83.333%; image-rendering: pixelated;
  outline: 1px solid #8a8780;
  print-color-adjust: exact; -webkit-print-color-adjust: exact; }
.slice svg { display: block; width: 100%; height: auto; }
svg.curve { width: 100%; max-width: 760px; height: auto; }
svg text { font-size: 10px; fill: var(--soft); font-family: inherit; }
svg .middle { text-anchor: middle; } svg .end { text-anchor: end; }
svg .grid { stroke: #e2e0da; stroke-width: .8; fill: none; }
svg .axis { stroke: #8a8780; stroke-width: .8; }
svg .mirror { stroke: #b9b6ae; stroke-width: .8; stroke-dasharray: 2 3; }
svg .ray { stroke: #c58a00; stroke-width: 1.6; }
svg .lamp { fill: #f0b400; stroke: #c58a00; }
svg .band { opacity: .16; }
svg .ball { fill: #8f8f8f; } svg .camera { fill: var(--ink); }
.key span { display: inline-block; width: 22px; height: 0; border-top: 3px solid; margin: 0 5px 3px 16px; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: 3px 22px; font-size: 14px; }
dt { color: var(--soft); } dd { margin: 0; overflow-wrap: anywhere; }
dd.print { font: 12px/1.7 "SFMono-Regular", Menlo, Consolas, "Liberation Mono", monospace; }
details summary { cursor: pointer; color: var(--soft); }
@media print { section { overflow: visible; } body { font-size: 11px; } main { padding: 0; max-width: none; }
  .verdict { font-size: 14px; }
  .plate { padding: 8px; } table { font-size: 11px; } th, td { padding-right: 9px; } svg.bar { width: 72px; }
  table.classes .plate { width: 96px; padding: 6px; } table.classes td.shot { padding-right: 6px; }
  table.classes td:last-child { overflow-wrap: anywhere; }
  figure, tr, .caution { break-inside: avoid; } h2 { break-after: avoid; margin-top: 24px; } }
"""


LIVE_STYLE = (
    STYLE
    + """
main { max-width: 1000px; padding-top: 28px; padding-bottom: 28px; }
h2 { margin-top: 24px; }
.plate { padding: 20px; }
.plate + figcaption { max-width: none; }
canvas { display: block; width: 100%; aspect-ratio: 1; border-radius: 50%; cursor: grab; touch-action: none;
  user-select: none; -webkit-user-select: none; }
canvas:focus { outline: none; }
canvas:focus-visible { outline: 2px solid #fff; outline-offset: 4px; }
.dragging canvas { cursor: grabbing; }
.lost canvas { opacity: .35; }
.first { display: grid; grid-template-columns: 296px 296px minmax(220px, 1fr); gap: 16px; margin-top: 18px; }
.candidates { display: grid; grid-template-columns: repeat(4, minmax(0, 1fr)); gap: 16px; }
.controls { padding-left: 12px; font-size: 14px; }
.controls p { margin: 0 0 10px; }
.controls label { display: block; }
.controls label output, dd output { font-variant-numeric: tabular-nums; }
.controls input { width: 100%; margin: 4px 0 12px; accent-color: var(--ink); }
.controls button { font: inherit; color: inherit; background: #fff; border: 1px solid var(--grey); border-radius: 3px;
  padding: 4px 14px; cursor: pointer; }
.controls button:hover { background: #f6f5f1; }
.controls dl { margin: 0 0 18px; font-size: 13px; line-height: 1.45; gap: 4px 16px; }
.controls button + dl { margin: 18px 0 0; }
kbd { font: inherit; border: 1px solid var(--line); border-radius: 3px; padding: 0 4px; }
@media (max-width: 900px) { .first { grid-template-columns: 1fr 1fr; } .controls { grid-column: 1 / -1; padding: 0; } }
@media (max-width: 640px) { .candidates { grid-template-columns: repeat(2, minmax(0, 1fr)); } }
"""
)
