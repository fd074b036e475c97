"""Loops over an image's points that compute direct light and reflections; see `known_light`."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from rfpp.raycast import ggx
from rfpp.raycast.compiled import compiled, float64
from rfpp.raycast.counted_random import Key, key_of, shift_of, spread
from rfpp.raycast.ggx import lobe_and_pdf
from rfpp.raycast.light_directions import light_sample, target_of
from rfpp.raycast.light_loops import direct_at, draw_lobe, emitter_light, over_density, rays_to_all
from rfpp.raycast.lit_scene import (
    LitScene,
    alpha_of,
    blurred,
    density_of_lobes,
    growth,
    intersect,
    scattering,
    slope_of,
    surface_at,
    texel_hit,
    tinted,
)
from rfpp.raycast.polygon_light import BLOCK, unoccluded_each
from rfpp.raycast.surface import Points
from rfpp.raycast.traces import Trace
from rfpp.raycast.vectors import BLACK, added, dot, in_frame, mean, product, scaled, tangents, triple

#: Sums over the samples of one light, for each point: unoccluded irradiance, that of visible samples, irradiance in
#: color, glossy light in color, and means and squares of the glossy lobe.
WHOLE, VISIBLE, DIFFUSE, GLOSSY, LOBE, SQUARES, SUMS = 0, 1, 2, 5, 8, 9, 10


@compiled
def light_samples(
    start: int,
    stop: int,
    scene: LitScene,
    light: int,
    points: Points,
    width: int,
    begin: int,
    end: int,
    only: Bool[np.ndarray, " pixels"],
    key: Key,
    sums: Float[np.ndarray, "r sums"],
) -> None:
    """Add samples of one light to the sums of each point.

    Args:
        width: Width of the image in pixels.
        begin, end: Range of sample numbers; number 0 resets the sums.
        only: Pixels whose points are sampled.
        sums: Sums to add to.
    """
    if begin == 0:
        sums[start:stop] = 0
    for row in range(start, stop):
        pixel = points.pixel[row]
        if not only[pixel]:
            continue
        point, normal = triple(points.point[row]), triple(points.normal[row])
        own, alpha = sums[row], points.alpha[row]
        first, second = tangents(normal)
        view = in_frame(points.eye[row], first, second, normal)
        target, (shift_u, shift_v) = target_of(scene, light, point, normal), shift_of(key_of(key, light), pixel, width)
        for s in range(begin, end):
            # all samples of a pixel's points are spread over the light together
            u, v = spread(s * points.of_pixel + points.nth[row], shift_u, shift_v)
            e, direction, density, arriving, clear = light_sample(scene, light, target, point, normal, u, v)
            own[WHOLE] += arriving
            if not clear:
                continue
            own[VISIBLE] += arriving
            toward = in_frame(direction, first, second, normal)
            by_area = toward[2] / density / np.pi
            by_lobe = 0.0
            if alpha >= 0:
                reflected, of_lobe = lobe_and_pdf(view, toward, alpha)
                by_lobe = reflected * over_density(density, of_lobe)
            shine = by_lobe * mean(scene.radiance[e])
            own[LOBE] += shine
            own[SQUARES] += shine * shine
            for c in range(3):
                own[DIFFUSE + c] += by_area * scene.radiance[e, c]
                own[GLOSSY + c] += by_lobe * scene.radiance[e, c]


@compiled
def of_light(
    start: int,
    stop: int,
    scene: LitScene,
    light: int,
    points: Points,
    around: Float[np.ndarray, " pixels"],
    edge: Bool[np.ndarray, " pixels"],
    few: int,
    many: int,
    sums: Float[np.ndarray, "r sums"],
    scratch: Float[np.ndarray, "scratch r"],
    diffuse: Float[np.ndarray, "r 3"],
    glossy: Float[np.ndarray, "r 3"],
) -> None:
    """Add the light of one light to each point.

    The irradiance of an exact light is β E + mean(w (V - β)): E is the closed form without occlusion, w the irradiance
    of a sample, V its visibility, and β is 1 where all samples of the pixels around the point's see the light, else 0.
    β depends on other pixels' samples alone, so no bias is measurable; where a light is wholly visible it is exact.

    Args:
        around: [pixels] results of `shares_around`.
        edge: [pixels] whether all samples were taken.
        few: Samples of points away from edges.
        scratch: Scratch space for `rfpp.raycast.polygon_light.unoccluded_each`.
        diffuse: Irradiance / π, added to.
    """
    for begin in range(start, stop, BLOCK):
        end = min(begin + BLOCK, stop)
        if scene.exact[light]:  # into the same numbers for every block, which are near
            unoccluded_each(begin, end, scene, light, points.point, points.normal, start, scratch)
        for row in range(begin, end):
            own, weight, share = sums[row], 1 / (many if edge[points.pixel[row]] else few), 0.0
            if scene.exact[light]:
                column, other = start + row - begin, around[points.pixel[row]]
                unoccluded = np.pi * (scratch[0, column] + scratch[1, column] + scratch[2, column]) / 3
                if unoccluded > 0:
                    share = max(other + weight * (own[VISIBLE] - other * own[WHOLE]) / unoccluded, 0.0)
                for c in range(3):
                    diffuse[row, c] += scratch[c, column] * share
            else:
                for c in range(3):
                    diffuse[row, c] += own[DIFFUSE + c] * weight
            for c in range(3):
                glossy[row, c] += own[GLOSSY + c] * weight


@compiled
def shares_around(
    points: Points,
    sums: Float[np.ndarray, "r sums"],
    height: int,
    width: int,
    of_pixels: Float[np.ndarray, "pixels 2"],
    around: Float[np.ndarray, " pixels"],
) -> None:
    """Fill in whether all samples in the eight pixels around each pixel see a light (1) or not (0)."""
    for row in range(len(points.pixel)):
        of_pixels[points.pixel[row], 0] += sums[row, WHOLE]
        of_pixels[points.pixel[row], 1] += sums[row, VISIBLE]
    for y in range(height):
        for x in range(width):
            whole, visible = 0.0, 0.0
            for j in range(max(y - 1, 0), min(y + 2, height)):
                for i in range(max(x - 1, 0), min(x + 2, width)):
                    if j != y or i != x:
                        whole += of_pixels[j * width + i, 0]
                        visible += of_pixels[j * width + i, 1]
            around[y * width + x] = 1.0 if whole > 0 and visible >= whole else 0.0


@compiled
def lobe_rays(
    start: int,
    stop: int,
    scene: LitScene,
    points: Points,
    width: int,
    samples: int,
    reflects: bool,
    key: Key,
    glossy: Float[np.ndarray, "r 3"],
    light: Float[np.ndarray, "r 3"],
    trace: Trace,
) -> None:
    """Cast rays of the glossy lobe; gather light of emitters, and of surfaces that they light.

    Args:
        width: Width of the image in pixels.
        samples: Largest number of rays per point: a mirror needs one, a weak lobe shows less noise.
        reflects: Gather light of surfaces, too.
        glossy: Glossy light by samples of the lights; that of the rays is added.
        light: Light of surfaces, filled in; see `Reflection`.
        trace: Derivatives of `light`, filled in.
    """
    traced = trace.triangle.shape[1] > 0
    for row in range(start, stop):
        alpha, specular = points.alpha[row], triple(points.specular[row])
        if alpha < 0:
            continue
        point, normal = triple(points.point[row]), triple(points.normal[row])
        first, second = tangents(normal)
        view = in_frame(points.eye[row], first, second, normal)
        own_diffuse, own_specular = mean(points.diffuse[row]), mean(specular)
        own_key, (shift_u, shift_v) = key_of(key, points.pixel[row]), shift_of(key, points.pixel[row], width)
        count = _rays(samples, alpha, own_specular)
        every = rays_to_all(scene) if count > 1 else 1
        emitted, reflection = BLACK, BLACK
        for s in range(count):
            number = s * points.of_pixel + points.nth[row]
            u, v = spread(number, shift_u, shift_v)
            toward, direction = draw_lobe(view, alpha, u, v, first, second, normal)
            if toward[2] <= 0:
                continue
            triangle, a, b, distance, there = intersect(scene, point, direction)
            if triangle < 0:
                continue
            if scene.emitter[triangle] >= 0:
                found = emitter_light(
                    scene, scene.emitter[triangle], point, normal, direction, distance, view, toward, alpha
                )
                emitted = added(emitted, found)
            if not reflects or distance <= 0:
                continue
            reflected, by_lobe = lobe_and_pdf(view, toward, alpha)
            weight = reflected / by_lobe
            seen_from, its_normal, back = surface_at(scene, triangle, a, b, direction, there)
            its_diffuse, its_specular = triple(scene.material[triangle]), triple(scene.material[triangle, 3:6])
            its_alpha = alpha_of(scene, triangle)
            texel = texel_hit(scene, triangle, a, b, distance * distance / max(by_lobe * count, 1.0))
            if texel >= 0:
                its_diffuse, its_specular = triple(scene.texels[texel]), triple(scene.texels[texel, 3:6])
                its_alpha = max(float64(scene.texels[texel, 6]) ** 2, ggx.MIN_ALPHA)
            cosine = dot(its_normal, back)
            shines = max(its_specular[0], its_specular[1], its_specular[2]) > 0 and cosine > 0
            density = density_of_lobes(own_diffuse, own_specular, toward[2], by_lobe)
            its_alpha = blurred(its_alpha, density) if shines else -1.0
            of_ray = key_of(own_key, 2 + number)
            diffuse_there, glossy_there = direct_at(
                scene, seen_from, its_normal, back, its_alpha, its_specular, 1, of_ray, True, every, number
            )
            leaving = added(product(its_diffuse, diffuse_there), product(its_specular, glossy_there))
            reflection = added(reflection, scaled(leaving, weight))
            if not traced:
                continue
            trace.triangle[row, s] = triangle
            slope = slope_of(scene, glossy_there, cosine, its_alpha, its_specular) if shines else glossy_there
            for c in range(3):
                trace.diffuse[row, s, c], trace.specular[row, s, c] = weight * diffuse_there[c], weight * slope[c]
        emitted = tinted(scene, scaled(emitted, 1 / count), view[2], alpha, specular)
        more = growth(scene, view[2], alpha, specular) if traced else BLACK
        for c in range(3):
            factor = scattering(scene, view[2], alpha, specular[c])
            glossy[row, c] = glossy[row, c] * factor + emitted[c]
            light[row, c] = reflection[c] * factor / count
            if not traced:
                continue
            trace.growth[row, c] = more[c]
            for s in range(count):
                trace.diffuse[row, s, c] *= factor / count
                trace.specular[row, s, c] *= factor / count


@compiled
def to_image(
    start: int,
    stop: int,
    pixel: Int[np.ndarray, " r"],
    light: Float[np.ndarray, "n r 3"],
    maps: Float[np.ndarray, "n pixels 3"],
) -> None:
    """Write the light at points to their pixels."""
    for kind in range(len(light)):
        for row in range(start, stop):
            for c in range(3):
                maps[kind, pixel[row], c] = light[kind, row, c]


@compiled
def _rays(samples: int, alpha: float, specular: float) -> int:
    if alpha <= ggx.MIN_ALPHA:
        return 1
    return min(max(int(np.ceil(samples * min(4 * specular, 1.0))), 1), samples)
