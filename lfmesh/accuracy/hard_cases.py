"""The hard cases: scenes made to break the tracer, each with an independent truth and a verdict.

A case passes if every ray has the right answer or ends as LOST, which the ledger counts with its reason.
"""

from collections.abc import Callable, Iterable

from lfmesh.accuracy.hard import (
    aim,
    arrays,
    bright_sensors,
    covers,
    diffraction,
    emitters,
    gloss,
    gradients,
    index_fields,
    interfaces,
    lamps,
    lenses,
    many_lamps,
    media,
    meshes,
    motions,
    openings,
    phases,
    pictures,
    round_targets,
    surfaces,
    tanks,
    waves,
)
from lfmesh.accuracy.hard.outcome import Outcome
from lfmesh.errors import collected

CASES: tuple[Callable[[], Outcome], ...] = (
    aim.vertices_and_edges,
    aim.pole_and_rim,
    aim.skinny_fan,
    openings.stop_of_20_um,
    openings.stop_of_10_nm,
    openings.hemispheres_to_the_lens,
    openings.hemispheres_to_the_sensor,
    interfaces.normal_incidence,
    interfaces.grazing,
    interfaces.grazing_sphere,
    interfaces.grazing_inside,
    interfaces.critical_angle,
    interfaces.matched_indices,
    interfaces.faint_glass,
    interfaces.dense_glass,
    lenses.ball_lens,
    lenses.hemisphere,
    meshes.corner_cube,
    meshes.trapped_light,
    lenses.cemented_triplet,
    lenses.thin_lenses_at_every_angle,
    lenses.flat_port_in_water,
    lenses.steep_face_into_oil,
    lenses.gap_10_um,
    lenses.gap_1_um,
    lenses.gap_100_nm,
    lenses.flat_gap_100_nm,
    lenses.thin_meniscus,
    lenses.touching_edges,
    lenses.touching_vertices,
    lenses.whispering_gallery,
    arrays.lenslets_5_um,
    arrays.lenslets_14_um,
    arrays.lenslets_14_um_in_oil,
    arrays.lenslets_500_um,
    arrays.far_and_tilted,
    arrays.lytro_size,
    arrays.square_borders,
    arrays.hexagonal_borders,
    arrays.across_cells,
    arrays.metalens_lenslets,
    phases.metalens_of_f_0_7,
    phases.metalens_up_to_evanescent_light,
    phases.grating_at_its_evanescent_limit,
    phases.phase_on_a_strong_asphere,
    gradients.rod_of_ten_pitches,
    gradients.along_the_edge_of_a_rod,
    gradients.turning_before_the_back_face,
    gradients.ball_of_luneburg,
    gradients.faint_gradient,
    gradients.face_between_gradients_of_one_index,
    gradients.gradient_behind_a_strong_asphere,
    index_fields.ball_that_turns_rays_round,
    index_fields.edges_and_corners_of_fields,
    index_fields.grazing_the_face_of_a_field,
    index_fields.turning_above_a_face,
    index_fields.faint_field,
    index_fields.fields_of_1_um_and_100_m,
    index_fields.duct_of_ten_pitches,
    index_fields.fields_that_touch,
    diffraction.lenslets_10_um_and_pixels_1_um,
    waves.lens_of_fresnel_number_one,
    waves.hyperboloid_of_f_0_6_before_a_plane_wave,
    covers.cover_of_air,
    covers.cover_of_index_4,
    covers.cover_of_air_in_oil,
    covers.cover_of_1_nm,
    covers.cover_of_10_m,
    covers.grazing_a_cover,
    covers.tilted_behind_a_cover,
    bright_sensors.sensor_that_detects_a_thousandth,
    bright_sensors.array_before_a_bright_sensor,
    meshes.target_100_m,
    meshes.target_1_mm,
    meshes.duplicate_faces,
    meshes.flipped_faces,
    meshes.zero_area,
    meshes.needles,
    meshes.t_junction,
    meshes.non_manifold,
    meshes.far_coordinates,
    meshes.million_triangles,
    meshes.coincident_vertices,
    meshes.glass_with_empty_facets,
    meshes.glass_with_duplicates,
    meshes.glass_with_flips,
    meshes.glass_with_junction,
    tanks.water_behind_a_window,
    tanks.glass_of_the_waters_index,
    tanks.film_of_air_in_water,
    tanks.glass_from_clear_to_black,
    tanks.total_reflection_in_absorbing_glass,
    emitters.emitter_on_the_surface,
    emitters.near_dim_facets_beside_far_bright_ones,
    emitters.ball_cut_by_the_horizon,
    round_targets.outline_of_a_ball,
    round_targets.grazed_cylinder,
    round_targets.grazed_ball_of_glass,
    media.depths_of_absorption,
    media.depths_of_scattering,
    media.sharp_phase_functions,
    media.one_voxel,
    media.plane_of_voxels,
    media.along_faces_of_cells,
    media.medium_at_the_lens,
    media.hottest_and_coldest_gas,
    media.lamp_beside_the_line,
    media.disk_lamp_on_the_line,
    media.camera_in_glowing_fog,
    gloss.gloss_at_its_ends,
    surfaces.ground_at_its_ends,
    surfaces.diffuse_grazed,
    surfaces.ground_grazed,
    surfaces.coating_at_its_ends,
    surfaces.polarisation_at_its_ends,
    surfaces.bands_at_their_ends,
    lamps.lamps_at_an_opal_front,
    lamps.tubes_at_an_opal_front,
    many_lamps.thousands_of_unequal_lamps,
    many_lamps.lamps_from_1_mm_to_100_m,
    lenses.diverging_newton,
    lenses.mild_asphere_of_a_deep_sphere,
    lenses.odd_powers,
    lenses.deep_toroid,
    lenses.steep_saddles,
    lenses.both_sides_of_a_kink,
    lenses.two_roots,
    lenses.hyperboloid,
    lenses.oblate,
    lenses.bulges_grazed,
    pictures.pixels_wider_than_lenslets_views,
    pictures.room_of_one_temperature,
    pictures.wall_behind_a_block,
    pictures.sums_of_a_red_band,
    pictures.caustic_of_a_ball,
    motions.ten_thousand_turns,
    motions.flash_of_a_nanosecond,
    motions.motion_of_a_picometre,
    motions.wall_from_half_a_kilometre,
    motions.exposures_of_a_picosecond_and_a_year,
    motions.walls_through_each_other,
    motions.poses_almost_half_a_turn_apart,
    motions.a_hundred_motions_at_once,
    motions.camera_that_turns_in_a_room,
)

ALLOWED_LOSS = 1e-7
"""Fraction of the emitted energy that may be lost over all cases."""


def run_all() -> list[Outcome]:
    """Run every case, in the order of `CASES`."""
    return [judged(case) for case in CASES]


def judged(case: Callable[[], Outcome]) -> Outcome:
    """Run one case without warnings: its outcome states the losses."""
    with collected():
        return case()


def lost_share(outcomes: Iterable[Outcome]) -> float:
    """Return the lost energy of all cases over their emitted energy."""
    outcomes = list(outcomes)
    emitted = sum(o.emitted for o in outcomes)
    return sum(o.lost_energy for o in outcomes) / emitted if emitted else 0.0


def line(outcome: Outcome) -> str:
    """Return an outcome as one line: cause, verdict, expected and actual result."""
    verdict = "passed" if outcome.passed else "FAILED"
    return (
        f"{verdict}  {outcome.cause} Expected: {outcome.expected}. Got: {outcome.got}; "
        f"{outcome.requeried} queries repeated, {outcome.lost_energy:g} of {outcome.emitted:g} lost."
    )
