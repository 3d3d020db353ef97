from .albedo import (
    ALBEDO_DEG as ALBEDO_DEG,
    albedo_rule as albedo_rule,
    directional_albedo as directional_albedo,
    reflects_too_much as reflects_too_much,
)
from .difference import (
    BRDFDifference as BRDFDifference,
    cell_difference as cell_difference,
    delta_e_2000 as delta_e_2000,
)
from .directions import (
    from_half_difference as from_half_difference,
    half_difference as half_difference,
)
from .gram import lower_gram as lower_gram
from .library import MaterialLibrary as MaterialLibrary
from .members import (
    check_different as check_different,
    position_among as position_among,
)
from .merl import (
    MerlTable as MerlTable,
    linear_lookups as linear_lookups,
    nearest_measured as nearest_measured,
)
from .merl_directory import (
    MERL_MATERIALS as MERL_MATERIALS,
    table_paths as table_paths,
)
from .merl_grid import (
    GRID as GRID,
    N_CELLS as N_CELLS,
    above_horizon as above_horizon,
    cell_centres as cell_centres,
    cell_index as cell_index,
    measured_share as measured_share,
    mirrored_cells as mirrored_cells,
    row_edges as row_edges,
)
from .metrics import (
    METRICS as METRICS,
    cell_measure as cell_measure,
    incident_cosine as incident_cosine,
)
from .norms import (
    column_norms as column_norms,
    norm_settings as norm_settings,
)
from .settings import (
    EMBEDDED as EMBEDDED,
    METRIC_NAMES as METRIC_NAMES,
    RESULT as RESULT,
    RESULT_STD as RESULT_STD,
    RGL_SUFFIX as RGL_SUFFIX,
    TABLE_SUFFIX as TABLE_SUFFIX,
    TABLE_SUFFIXES as TABLE_SUFFIXES,
)
from .stored_columns import (
    ROW_CELLS as ROW_CELLS,
    Part as Part,
    StoredColumns as StoredColumns,
    columns_of as columns_of,
    unpacked as unpacked,
)
from .tables import read_table as read_table
from .texture import brdf_texture as brdf_texture
from .verification import (
    Verification as Verification,
    VerifiedTable as VerifiedTable,
    verify as verify,
)
