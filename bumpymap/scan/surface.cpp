// Finds the ground of a scan as a smooth surface.
//
// Points are sorted into small bins around the sensor. The lowest points of a bin, its layer, may be ground. A plane
// through the layers leans as the whole ground does. From it the ground is followed outwards, column by column, with
// the height and slope that are expected and how sure they are (Kalman 1960): what continues it is accepted. Then the
// surface is fitted in three levels of overlapping windows, each half as wide as the one before, to the accepted layers
// and to what lies close to the surface. All sums are exact or over bins, so neither the order of the points nor the
// sectors matter. Labels within and across columns and a slope with its uncertainty: after Li and Schwieger 2026
// (arXiv 2605.08952). Ours.
#include "surface.hpp"

namespace bumpy {
namespace {

// ---- Layers ----

// Points that are so far above the lowest of their bin belong to its layer, m; those up to this over it show that it is
// no layer, but the side of an object.
constexpr float layer_m = 0.12F, stack_m = 0.8F;
constexpr float nothing = std::numeric_limits<float>::infinity();

// Sums over the layer of a bin; `over`: points not far over it.
struct Layer {
    double count = 0.0, x = 0.0, y = 0.0, z = 0.0, over = 0.0;
};

// Memory of the next loop.
struct LayerSums {
    Scratch<float> lowest;  // (bins,) m
    Scratch<Layer> layers;
};

// Finds the layer of every bin.
Layers find_layers(const PlacedPoints& points, const BinRings& rings) {
    const Index bins = rings.count * bin_columns;
    auto& [lowest, layers] = kept_memory<LayerSums>();
    renew(lowest, bins, nothing);
    renew(layers, bins);
    for (const PlacedPoint& p : points) lowest[p.bin] = std::min(lowest[p.bin], p.z);
    for (const PlacedPoint& p : points) {
        const float over = p.z - lowest[p.bin];
        if (over >= layer_m + stack_m) continue;
        Layer& layer = layers[p.bin];
        if (over >= layer_m) {
            layer.over += 1.0;
            continue;
        }
        layer.count += 1.0;
        layer.x += exact(p.x);
        layer.y += exact(p.y);
        layer.z += exact(p.z);
    }
    Layers out;
    for (Index bin = 0; bin < bins; ++bin) {
        const auto [count, x, y, z, over] = layers[bin];
        if (count == 0.0) continue;
        out.x.push_back(x / count);
        out.y.push_back(y / count);
        out.z.push_back(z / count);
        out.r.push_back(std::sqrt(out.x.back() * out.x.back() + out.y.back() * out.y.back()));
        out.share.push_back(count / (count + over));
        out.weight.push_back(out.share.back() * std::min(count, 3.0) / 3.0);
        out.bin.push_back(static_cast<std::int32_t>(bin));
    }
    return out;
}

// ---- The whole ground ----

// Distances from the plane at which a layer counts half, from fit to fit: at the sensor, m; they grow by
// this of themselves with each metre.
constexpr std::array<double, 5> plane_scales{infinite, 4.0, 1.0, 0.5, 0.3};
constexpr double scale_per_metre = 0.05;

// The plane that most layers lie on, and the others above.
Tilt fit_whole(const Layers& layers) {
    Tilt plane;
    for (const double scale : plane_scales) {
        Sums sums;
        for (Index i = 0; i < layers.size(); ++i) {
            const double h = plane.above(layers.x[i], layers.y[i], layers.z[i]);
            const double t = h / (scale * (1.0 + scale_per_metre * layers.r[i]));
            sums.add(1.0 / (1.0 + t * t), layers.x[i], layers.y[i], layers.z[i]);
        }
        plane = sums.solve(1e-6, 1e-3);
    }
    return plane;
}

// ---- The ground followed outwards ----

// Where a column starts, under the sensor: standard deviation of height and slope against the whole ground, m and 1.
constexpr double start_height = 0.05, start_slope = 0.02;
// Variance that the slope gains with each metre; standard deviation of a layer's height, m and for each metre away.
constexpr double slope_walk = 0.001, layer_noise = 0.03, layer_noise_per_metre = 0.002;
// A layer of at least this share continues the ground up to these multiples of the standard deviation, and m, above it
// and below it.
constexpr double flat_share = 0.5;
constexpr double above_sure = 1.5, above_m = 0.08, below_sure = 3.0, below_m = 0.15;

// The ground of a column where it was last seen, above the plane of the whole: distance, height, slope, and their
// covariances.
struct Front {
    double r = 0.0, h = 0.0, slope = 0.0;
    double hh = start_height * start_height, hs = 0.0, ss = start_slope * start_slope;

    // Moves on to a distance, m.
    void move(double at) {
        const double d = std::max(at - r, 0.0);
        h += slope * d;
        hh += d * (2.0 * hs + d * (ss + d * (slope_walk / 3.0)));
        hs += d * (ss + d * (0.5 * slope_walk));
        ss += d * slope_walk;
        r = std::max(at, r);
    }

    // Takes a layer at a height above the plane for ground if it continues it; returns whether it does.
    bool take(double height) {
        const double noise = layer_noise + layer_noise_per_metre * r;
        const double sum = hh + noise * noise, sure = std::sqrt(sum);
        double over = height - h;
        if (over > above_sure * sure + above_m || over < -below_sure * sure - below_m) return false;
        over = std::clamp(over, -3.0 * sure, 3.0 * sure);
        const double gain = hh / sum, slope_gain = hs / sum;
        h += gain * over;
        slope += slope_gain * over;
        ss -= slope_gain * hs;
        hs *= 1.0 - gain;
        hh *= 1.0 - gain;
        return true;
    }
};

// Finds the layers that continue the ground of their column, outwards.
Scratch<std::uint8_t> follow(const Layers& layers, Tilt plane) {
    Scratch<std::uint8_t> continues(layers.size());
    Scratch<Front> columns(bin_columns);
    for (Index i = 0; i < layers.size(); ++i) {
        Front& front = columns[layers.bin[i] % bin_columns];
        front.move(layers.r[i]);
        continues[i] = layers.share[i] >= flat_share && front.take(plane.above(layers.x[i], layers.y[i], layers.z[i]));
    }
    return continues;
}

// ---- The surface ----

// Windows of a level: bins from the middle of one to the next, outwards and around.
constexpr std::array<Index, 3> level_steps{16, 8, 4};
// A layer that continues the ground counts up to this height above the windows' plane, m and for each metre from the
// sensor, in the first level, and half of it in each next one; any other up to this height.
constexpr double continuing_m = 3.0, continuing_per_metre = 0.3, other_m = 0.25, other_per_metre = 0.05;
// Slopes are pulled to the parent's at this share of a window's width from its middle.
constexpr double pull_share = 0.7;

// Fits the planes of a level, which come as those of the level before, to the layers near them.
void fit_level(
    const Layers& layers, const Scratch<std::uint8_t>& continues, const BinRings& rings, std::size_t number,
    Level& level) {
    struct Fit {
        double x, y, scale;  // middle of the window, m, and the inverse of the distance at which slopes are pulled
        Sums sums;
    };
    Scratch<Fit> fits(level.size());
    for (Index window = 0; window < level.size(); ++window) {
        const auto [x, y] = level.centre(window, rings);
        const double wide = std::sqrt(x * x + y * y) * static_cast<double>(level.step()) / octave_rings;
        fits[window] = {x, y, 1.0 / (pull_share * wide), {}};
    }
    const double half = 1.0 / static_cast<double>(1 << number);
    for (Index i = 0; i < layers.size(); ++i) {
        const auto [ring, column] = layers.middle(i);
        const Windows at = level.around(ring, column);
        const double x = layers.x[i], y = layers.y[i], z = layers.z[i], r = layers.r[i];
        const double h = level.blend(at).above(x, y, z);
        double reach = other_m + other_per_metre * r;
        if (continues[i] != 0) reach = std::max(reach, half * (continuing_m + continuing_per_metre * r));
        const double left = 1.0 - h * h / (reach * reach);  // Tukey's biweight
        if (left <= 0.0) continue;
        const double weight = layers.weight[i] * left * left;
        for (std::size_t k = 0; k < 4; ++k) {
            Fit& fit = fits[at.number[k]];
            const double over = level.planes[at.number[k]].above(x, y, z);
            fit.sums.add(weight * at.weight[k], (x - fit.x) * fit.scale, (y - fit.y) * fit.scale, over);
        }
    }
    for (Index window = 0; window < level.size(); ++window) {
        const Fit& fit = fits[window];
        const Tilt change = fit.sums.solve(1.0, 1.0);
        const double a = change.a * fit.scale, b = change.b * fit.scale;
        Tilt& plane = level.planes[window];
        plane = {plane.a + a, plane.b + b, plane.c + change.c - a * fit.x - b * fit.y};
    }
}

// Fits the levels of the surface, one after the other.
std::vector<Level> fit_levels(const Layers& layers, const BinRings& rings, Tilt whole) {
    const Scratch<std::uint8_t> continues = follow(layers, whole);
    std::vector<Level> levels;
    for (std::size_t number = 0; number < level_steps.size(); ++number) {
        Level level(level_steps[number], rings);
        for (Index window = 0; window < level.size(); ++window) {
            const auto [ring, column] = level.middle(window);
            level.planes.push_back(number > 0 ? levels.back().at(ring, column) : whole);
        }
        fit_level(layers, continues, rings, number, level);
        levels.push_back(std::move(level));
    }
    return levels;
}

}  // namespace

Surface find_surface(const PlacedPoints& points, const BinRings& rings) {
    Layers layers = find_layers(points, rings);
    const Tilt whole = fit_whole(layers);
    std::vector<Level> levels = fit_levels(layers, rings, whole);
    return {std::move(layers), whole, std::move(levels)};
}

}  // namespace bumpy
