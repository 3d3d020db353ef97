from .accuracy import (
    BASELINES as BASELINES,
    Experiment as Experiment,
    Setting as Setting,
    parse_choice as parse_choice,
    parse_value as parse_value,
    settings_of as settings_of,
)
from .accuracy_cases import (
    Case as Case,
    breakdown_table as breakdown_table,
    summary_table as summary_table,
)
from .families import (
    by_relatives as by_relatives,
    family as family,
    relatives as relatives,
    without_relatives as without_relatives,
)
from .meshes import (
    FRONT as FRONT,
    cap as cap,
    few_normals as few_normals,
    mesh_view as mesh_view,
)
from .probes import (
    SHARED as SHARED,
    default_probes as default_probes,
    open_probes as open_probes,
    tilt as tilt,
)
from .restorer import (
    Restorer as Restorer,
    relative as relative,
)
from .scenes import (
    CellSample as CellSample,
    Images as Images,
    Scene as Scene,
    directional_scene as directional_scene,
    noisy_observations as noisy_observations,
)
from .sheets import (
    common_exposure as common_exposure,
    on_white as on_white,
    write_sheet as write_sheet,
)
from .sweep_inputs import (
    SweepInputs as SweepInputs,
    light_under as light_under,
    open_library as open_library,
    sweep_options as sweep_options,
    swept_probe as swept_probe,
)
from .tables import (
    Rows as Rows,
    check_document as check_document,
    markdown_table as markdown_table,
    percent as percent,
    read_rows as read_rows,
    replace_results as replace_results,
    write_rows as write_rows,
)
from .targets import (
    FORMAT as FORMAT,
    Target as Target,
    negative_share as negative_share,
    read_targets as read_targets,
)
