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
// Lower than the bins around, m and for each metre from the sensor, with fewer than this number as low: a reflection.
constexpr double gap_m = 0.4, gap_per_metre = 0.03;
constexpr int company = 2;
// The ground in a bin of reflections: this share of the known bins around is lower.
constexpr double low_share = 0.3;

constexpr float nothing = std::numeric_limits<float>::infinity();

// Heights between which the points of a bin are its layer, m.
struct Band {
    float low = nothing, high = nothing;
};

// That of a bin: from its lowest point up, or around the ground of the bins around if that is a reflection.
Band band_of(Index bin, const Scratch<float>& lowest, const BinRings& rings) {
    const float own = lowest[bin];
    const double away = rings.distance(static_cast<double>(bin / bin_columns));
    const auto gap = static_cast<float>(gap_m + gap_per_metre * away);
    int near = 0;
    std::array<float, 24> others;
    std::size_t known = 0;
    around_bin(bin, 2, rings.count, [&](Index beside) {
        const float other = lowest[beside];
        if (other == nothing) return true;
        others[known++] = other;
        near += std::abs(other - own) < gap;
        return near < company;
    });
    if (near >= company || known < 3) return {own, own + layer_m};
    const auto low = others.begin() + static_cast<std::ptrdiff_t>(low_share * static_cast<double>(known - 1));
    std::nth_element(others.begin(), low, others.begin() + static_cast<std::ptrdiff_t>(known));
    return own < *low - gap ? Band{*low - gap, *low + layer_m} : Band{own, own + layer_m};
}

// Sums over the layer of a bin; `over`: points not far over it.
struct Layer {
    double count = 0.0, x = 0.0, y = 0.0, z = 0.0, over = 0.0;
};

// Memory of the next loop.
struct LayerSums {
    Scratch<float> lowest;  // (bins,) m
    Scratch<Band> bands;
    Scratch<Layer> layers;
};

// Finds the layer of every bin, above a plane.
Layers find_layers(const PlacedPoints& points, const BinRings& rings, Tilt plane) {
    const Index bins = rings.count * bin_columns;
    auto& [lowest, bands, layers] = kept_memory<LayerSums>();
    renew(lowest, bins, nothing);
    renew(bands, bins);
    renew(layers, bins);
    const auto height = [plane](const PlacedPoint& p) { return static_cast<float>(plane.above(p.x, p.y, p.z)); };
    for (const PlacedPoint& p : points) lowest[p.bin] = std::min(lowest[p.bin], height(p));
    for (Index bin = 0; bin < bins; ++bin)
        if (lowest[bin] != nothing) bands[bin] = band_of(bin, lowest, rings);
    for (const PlacedPoint& p : points) {
        const Band band = bands[p.bin];
        const float h = height(p);
        if (!(band.low <= h && h < band.high + stack_m)) continue;
        Layer& layer = layers[p.bin];
        if (h >= band.high) {
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
// `scale_per_metre` of themselves, and are larger below the plane by this factor. Layers farther than `far_m` count
// less.
constexpr std::array<double, 7> plane_scales{infinite, 4.0, 2.0, 1.0, 0.6, 0.4, 0.3};
constexpr double scale_per_metre = 0.05, scale_below = 2.0, far_m = 40.0, far_weight = 0.2;
// The lowest points are searched for again along the plane if it is steeper than this.
constexpr double leans = 0.06;

// The plane that most layers lie on, and the others above.
Tilt fit_whole(const Layers& layers) {
    Tilt plane;
    for (const double scale : plane_scales) {
        Sums sums;
        for (Index i = 0; i < layers.size(); ++i) {
            const double h = plane.above(layers.x[i], layers.y[i], layers.z[i]);
            const double t = h / (scale * (1.0 + scale_per_metre * layers.r[i]) * (h > 0.0 ? 1.0 : scale_below));
            sums.add((layers.r[i] < far_m ? 1.0 : far_weight) / (1.0 + t * t), layers.x[i], layers.y[i], layers.z[i]);
        }
        plane = sums.solve(1e-6, 1e-3);
    }
    return plane;
}

// ---- The ground followed outwards ----

// Where a column starts, under the sensor: standard deviation of height and slope against the whole ground, m and 1.
constexpr double start_height = 0.05, start_slope = 0.02;
// Variance that the slope gains with each metre; standard deviation of a layer's height, m and for each metre away; and
// of the height for each metre to a neighbouring column.
constexpr double slope_walk = 0.001, layer_noise = 0.03, layer_noise_per_metre = 0.002, across_slope = 0.1;
// A layer of at least this share continues the ground up to these multiples of the standard deviation, and m, above it
// and below it.
constexpr double flat_share = 0.5;
constexpr double above_sure = 1.5, above_m = 0.08, below_sure = 3.0, below_m = 0.15;

// The ground of all columns where it was last seen, above the plane of the whole; a column at each end stands for the
// one at the other.
struct Front {
    std::array<double, bin_columns + 2> r{}, h{}, slope{}, hh{}, hs{}, ss{};

    Front() {
        hh.fill(start_height * start_height);
        ss.fill(start_slope * start_slope);
    }

    void close() {
        for (auto* values : {&r, &h, &slope, &hh, &hs, &ss}) {
            values->front() = (*values)[bin_columns];
            values->back() = (*values)[1];
        }
    }

    double variance(std::size_t k, double at) const {
        const double d = std::max(at - r[k], 0.0);
        return hh[k] + d * (2.0 * hs[k] + d * (ss[k] + d * (slope_walk / 3.0)));
    }

    // Moves the ground of column `from` of another front on to a distance, m, of column k.
    void move(std::size_t k, const Front& other, std::size_t from, double at, double more) {
        const double d = std::max(at - other.r[from], 0.0);
        r[k] = std::max(at, other.r[from]);
        h[k] = other.h[from] + other.slope[from] * d;
        slope[k] = other.slope[from];
        hh[k] = other.variance(from, at) + more;
        hs[k] = other.hs[from] + d * (other.ss[from] + d * (0.5 * slope_walk));
        ss[k] = other.ss[from] + d * slope_walk;
    }

    // Takes a layer at a height above the plane for ground if it continues it; returns whether it does.
    bool take(std::size_t k, double height) {
        const double noise = layer_noise + layer_noise_per_metre * r[k];
        const double sum = hh[k] + noise * noise, sure = std::sqrt(sum);
        double over = height - h[k];
        if (over > above_sure * sure + above_m || over < -below_sure * sure - below_m) return false;
        over = std::clamp(over, -3.0 * sure, 3.0 * sure);
        const double gain = hh[k] / sum, slope_gain = hs[k] / sum;
        h[k] += gain * over;
        slope[k] += slope_gain * over;
        ss[k] -= slope_gain * hs[k];
        hs[k] *= 1.0 - gain;
        hh[k] *= 1.0 - gain;
        return true;
    }
};

// Finds the layers that continue the ground, ring by ring. A column goes on from its own last ground, or from that of a
// column beside it where that is surer.
Scratch<std::uint8_t> follow(const Layers& layers, const BinRings& rings, Tilt plane) {
    Scratch<std::uint8_t> continues(layers.size());
    Front front;
    Index i = 0;
    for (Index ring = 0; ring < rings.count; ++ring) {
        std::array<Index, bin_columns> here;
        here.fill(-1);
        for (; i < layers.size() && layers.bin[i] / bin_columns == ring; ++i)
            here[static_cast<std::size_t>(layers.bin[i] % bin_columns)] = i;
        front.close();
        const Front before = front;
        const double middle = rings.distance(static_cast<double>(ring) + 0.5);
        const double side = across_slope * (2.0 * std::numbers::pi / bin_columns) * middle;
        for (std::size_t k = 1; k <= bin_columns; ++k) {
            const Index own = here[k - 1];
            const double at = own < 0 ? middle : layers.r[own];
            std::size_t from = k;
            double least = before.variance(k, at);
            for (const std::size_t beside : {k - 1, k + 1}) {
                const double other = before.variance(beside, at) + side * side;
                if (other < least) {
                    least = other;
                    from = beside;
                }
            }
            if (own < 0 && from == k) continue;
            front.move(k, before, from, at, from == k ? 0.0 : side * side);
            if (own < 0 || layers.share[own] < flat_share) continue;
            continues[own] = front.take(k, plane.above(layers.x[own], layers.y[own], layers.z[own]));
        }
    }
    return continues;
}

// ---- The surface ----

// Windows of a level: bins from the middle of one to the next, outwards and around.
constexpr std::array<Index, 3> level_steps{16, 8, 4};
// A layer that continues the ground counts up to this height above the windows' plane, m and for each metre from the
// sensor, in the first level, and half of it in each next one; any other up to this height. Below the plane, both count
// farther by this factor.
constexpr double continuing_m = 3.0, continuing_per_metre = 0.3, other_m = 0.25, other_per_metre = 0.05, deeper = 2.0;
// The least of these heights, m.
constexpr double least_window_m = 0.3;
// Slopes are pulled to the parent's at this share of a window's width from its middle.
constexpr double pull_share = 0.7;
// Weight of a layer that does not continue the ground, by level.
constexpr std::array<double, 3> other_weights{0.2, 0.5, 1.0};

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
        double reach = other_m + other_per_metre * r, weight = layers.weight[i];
        if (continues[i] != 0) {
            reach = std::max(reach, half * (continuing_m + continuing_per_metre * r));
        } else {
            weight *= other_weights[number];
        }
        reach = std::max(reach, least_window_m) * (h > 0.0 ? 1.0 : deeper);
        const double left = 1.0 - h * h / (reach * reach);  // Tukey's biweight
        if (left <= 0.0) continue;
        weight *= left * left;
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
    const Scratch<std::uint8_t> continues = follow(layers, rings, whole);
    std::vector<Level> levels;
    for (std::size_t number = 0; number < level_steps.size(); ++number) {
        Level level(level_steps[number], rings);
        for (Index window = 0; window < level.size(); ++window) {
            const auto [x, y] = level.centre(window, rings);
            const auto [ring, column] = level.middle(window);
            level.planes.push_back(number > 0 ? levels.back().touch(x, y, ring, column) : whole);
        }
        fit_level(layers, continues, rings, number, level);
        levels.push_back(std::move(level));
    }
    return levels;
}

}  // namespace

Surface find_surface(const PlacedPoints& points, const BinRings& rings) {
    Layers layers = find_layers(points, rings, {});
    Tilt whole = fit_whole(layers);
    if (whole.a * whole.a + whole.b * whole.b > leans * leans) {
        layers = find_layers(points, rings, whole);
        whole = fit_whole(layers);
    }
    std::vector<Level> levels = fit_levels(layers, rings, whole);
    return {std::move(layers), whole, std::move(levels)};
}

}  // namespace bumpy
