// Finds the ground of a scan as a smooth surface, and measures the places around the sensor.
//
// Points are sorted into small bins around the sensor. The lowest points of a bin, its layer, may be ground. A plane
// through the layers leans as the whole ground does. From it the ground is followed outwards, column by column, with
// the height and slope that are expected and how sure they are (Kalman 1960): what continues it is accepted. Then the
// surface is fitted in three levels of overlapping windows, each half as wide as the one before, to the accepted layers
// and to what lies close to the surface. The noise of the ground and the plants in the bins say up to which height over
// it points are ground. All sums are exact or over bins, so neither the order of the points nor the sectors matter.
// Labels within and across columns and a slope with its uncertainty: after Li and Schwieger 2026 (arXiv 2605.08952).
// Ours.
#include "surface.hpp"

namespace bumpy {
namespace {

// Sums by bin: memory that is kept from scan to scan.
struct BinSums {
    Scratch<Four> layer;            // number of points in the layer, sums of x, y and z, m
    Scratch<std::int32_t> stacked;  // points not far over the layer
    Scratch<Tilt> planes;           // that touch the surface
    Scratch<Four> ground;           // see `GroundSum`
};

// The same by bin when it is known what is ground: of ground points, and the numbers of others below the belly, up to
// the vehicle's height, and above.
struct PlaceSums {
    Scratch<Four> ground, others;
};

// ---- Layers ----

// The layers of the bins that have one, inwards first: their lowest points, which may be ground.
struct Layers {
    Scratch<double> x, y, z, r;     // mean of the points, distance, m
    Scratch<double> weight, share;  // by their number; of the points of the bin that are in it, or not far over it
    Scratch<std::int32_t> bin;

    Index size() const { return x.count(); }

    // The middle of a layer's bin, in bins outwards and around.
    std::array<double, 2> middle(Index i) const {
        return {static_cast<double>(bin[i] / bin_columns) + 0.5, static_cast<double>(bin[i] % bin_columns) + 0.5};
    }
};

// Points that are so far above the lowest of their bin belong to its layer, m; those up to this over it show that it is
// no layer, but the side of an object.
constexpr float layer_m = 0.12F, stack_m = 0.8F;

// Finds the layer of every bin.
Layers find_layers(const PlacedPoints& points, const BinRings& rings, BinSums& s) {
    const Index bins = rings.count * bin_columns;
    renew(s.layer, bins);
    renew(s.stacked, bins);
    for (Index i = 0; i < points.count(); ++i) {
        const ScanPoint& p = points.point[i];
        const Index bin = points.place[i].bin;
        const float over = p.z - points.lowest[bin];
        if (over < layer_m) add_exact(s.layer[bin], Four{1.0, p.x, p.y, p.z});
        s.stacked[bin] += (over >= layer_m) & (over < layer_m + stack_m);
    }
    Layers out;
    for (Index bin = 0; bin < bins; ++bin) {
        const Four& sum = s.layer[bin];
        const double count = sum[0];
        if (count == 0.0) continue;
        out.x.push_back(sum[1] / count);
        out.y.push_back(sum[2] / count);
        out.z.push_back(sum[3] / count);
        out.r.push_back(std::sqrt(out.x.back() * out.x.back() + out.y.back() * out.y.back()));
        out.share.push_back(count / (count + s.stacked[bin]));
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
        FitSums<double> sums;
        for (Index i = 0; i < layers.size(); ++i) {
            const double h = plane.above(layers.x[i], layers.y[i], layers.z[i]);
            const double t = h / (scale * (1.0 + scale_per_metre * layers.r[i]));
            sums.add(1.0 / (1.0 + t * t), layers.x[i], layers.y[i], layers.z[i]);
        }
        plane = fit_plane(sums, 1e-6, 1e-3);
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

// A window of a level in work.
struct WindowFit {
    double x, y, scale;  // its middle, m, and the inverse of the distance at which slopes are pulled
    FitSums<double> sums;
};

// The four windows around a place, side by side: neighbours share them, so that sums go to the windows but now and
// then.
struct FourWindows {
    std::array<Index, 4> number{};
    Four x{}, y{}, scale{}, a{}, b{}, c{};  // as in `WindowFit`; their planes
    FitSums<Four> sums;

    void move(const std::array<Index, 4>& to, const Level& level, Scratch<WindowFit>& fits) {
        for (std::size_t k = 0; k < 4; ++k) fits[number[k]].sums.add(sums, k);
        sums = {};
        number = to;
        for (std::size_t k = 0; k < 4; ++k) {
            const WindowFit& fit = fits[number[k]];
            const Tilt& plane = level.planes[number[k]];
            x[k] = fit.x;
            y[k] = fit.y;
            scale[k] = fit.scale;
            a[k] = plane.a;
            b[k] = plane.b;
            c[k] = plane.c;
        }
    }
};

// Fits the planes of a level, which come as those of the level before, to the layers near them.
void fit_level(
    const Layers& layers, const Scratch<std::uint8_t>& continues, const BinRings& rings, std::size_t number,
    Level& level) {
    Scratch<WindowFit> fits(level.size());
    for (Index window = 0; window < level.size(); ++window) {
        const auto [ring, column] = level.middle(window);
        const double r = rings.distance(ring), turn = column * (2.0 * std::numbers::pi / bin_columns);
        const double x = r * std::cos(turn), y = r * std::sin(turn);
        const double wide = std::sqrt(x * x + y * y) * static_cast<double>(level.step()) / octave_rings;
        fits[window] = {x, y, 1.0 / (pull_share * wide), {}};
    }
    const double half = 1.0 / static_cast<double>(1 << number);
    FourWindows four;
    for (Index i = 0; i < layers.size(); ++i) {
        const auto [ring, column] = layers.middle(i);
        const Windows at = level.around(ring, column);
        if (at.number != four.number) four.move(at.number, level, fits);
        const double x = layers.x[i], y = layers.y[i], z = layers.z[i], r = layers.r[i];
        const Tilt plane{sum_of(at.weight * four.a), sum_of(at.weight * four.b), sum_of(at.weight * four.c)};
        const double h = plane.above(x, y, z);
        double reach = other_m + other_per_metre * r;
        if (continues[i] != 0) reach = std::max(reach, half * (continuing_m + continuing_per_metre * r));
        const double left = 1.0 - h * h / (reach * reach);  // Tukey's biweight
        if (left <= 0.0) continue;
        const double weight = layers.weight[i] * left * left;
        const Four over = z - (four.a * x + four.b * y + four.c);
        four.sums.add(weight * at.weight, (x - four.x) * four.scale, (y - four.y) * four.scale, over);
    }
    four.move({}, level, fits);
    for (Index window = 0; window < level.size(); ++window) {
        const WindowFit& fit = fits[window];
        const Tilt change = fit_plane(fit.sums, 1.0, 1.0);
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

// ---- The points on the ground ----

// Points are ground up to this multiple of the noise of the ground over the surface, with limits, m.
constexpr double reach_of_noise = 10.0, least_reach = 0.15, most_reach = 0.25;
// The noise is the spread of the points up to this height over the surface, m, in bins that have this number of them:
// the median over the bins of an octave that has this number of those. Where none has, it is this, m.
constexpr float near_surface = 0.2F;
constexpr double least_points = 5.0, usual_noise = 0.03;
constexpr Index least_bins = 16;
// Plants stand in a bin and those around it if between `near_surface` and this height, m, there are points, as a share
// of those near the surface, and those spread in their bins by more than this multiple of the noise and this, m. They
// stand in the bin itself if it has at least this share of such points, or spreads so.
constexpr float plants_top = 0.95F;
constexpr double plants_share = 0.5, own_share = 0.1, plants_spread = 1.6, plants_least = 0.043;
// Slope of 38 degrees: tan(radians(38)). What is steeper is no ground.
const double steepest = std::tan(38.0 * (std::numbers::pi / 180.0));
// Ground that is higher than this above the origin, m, must have objects on it that are higher than this, m, and more
// of them than hang below it: a frame may have its origin below the robot, or z may point down.
constexpr double highest = 0.5;
constexpr float stands = 0.5F;

// Sums over ground points: number, sum and squares of heights; and the number of those that show plants.
enum GroundSum : std::size_t { near, sum, squares, rising };

// Sum of the squares of the heights about their mean.
double scatter_of(const Four& bin) {
    return bin[near] > 0.0 ? std::max(bin[squares] - bin[sum] * bin[sum] / bin[near], 0.0) : 0.0;
}

// Finds the heights of all points, and sums those near the surface by bin; returns whether no more stand on it than
// hang below it.
bool find_heights(
    const PlacedPoints& points, const Layers& layers, const Level& surface, Scratch<float>& heights, BinSums& s) {
    s.planes.resize(s.layer.size());
    renew(s.ground, s.layer.count());
    heights.resize(points.point.size());
    for (Index i = 0; i < layers.size(); ++i) {
        const auto [ring, column] = layers.middle(i);
        s.planes[layers.bin[i]] = surface.at(ring, column);
    }
    Index higher = 0, lower = 0;
    for (Index i = 0; i < points.count(); ++i) {
        const ScanPoint& p = points.point[i];
        const Index bin = points.place[i].bin;
        const auto h = static_cast<float>(s.planes[bin].above(p.x, p.y, p.z));
        heights[i] = h;
        higher += h > stands;
        lower += h < -stands;
        const double is_near = (below_surface < h) & (h < near_surface) ? 1.0 : 0.0, high = is_near * h;
        add_exact(s.ground[bin], Four{is_near, high, high * h, (h >= near_surface) & (h < plants_top) ? 1.0 : 0.0});
    }
    return higher <= lower;
}

// The noise of the ground in every ring, m: between the medians of octaves.
Scratch<double> find_noise(const Scratch<Four>& bins, const BinRings& rings) {
    Scratch<double> out(rings.count, usual_noise), spreads;
    double before = -1.0, last = usual_noise;
    for (Index begin = 0; begin < rings.count; begin += octave_rings) {
        spreads.clear();
        const Index end = std::min(begin + octave_rings, rings.count) * bin_columns;
        for (Index bin = begin * bin_columns; bin < end; ++bin)
            if (bins[bin][near] >= least_points) spreads.push_back(std::sqrt(scatter_of(bins[bin]) / bins[bin][near]));
        if (spreads.count() < least_bins) continue;
        const auto middle = spreads.begin() + spreads.count() / 2;
        std::nth_element(spreads.begin(), middle, spreads.end());
        const double here = static_cast<double>(begin) + 0.5 * octave_rings;
        for (Index ring = 0; ring < rings.count; ++ring) {
            const auto at = static_cast<double>(ring);
            if (at < before) continue;
            const double share = before < 0.0 ? 1.0 : std::min((at - before) / (here - before), 1.0);
            out[ring] = last + share * (*middle - last);
        }
        before = here;
        last = *middle;
    }
    return out;
}

// Finds up to which height the points of each bin are ground: none in steep bins, and in those in which plants rise.
void find_reaches(const BinRings& rings, Scratch<float>& reaches, const BinSums& s) {
    struct Spread {
        double count, rising, scatter;
    };
    const Scratch<double> noise = find_noise(s.ground, rings);
    Scratch<Spread> spreads;
    spreads.reserve(s.ground.size());
    for (const Four& bin : s.ground) spreads.push_back({bin[near], bin[rising], scatter_of(bin)});
    reaches.resize(s.ground.size());
    for (Index bin = 0; bin < reaches.count(); ++bin) {
        const Spread& own = spreads[bin];
        const Index ring = bin / bin_columns;
        const auto [a, b, c] = s.planes[bin];
        reaches[bin] = static_cast<float>(std::clamp(reach_of_noise * noise[ring], least_reach, most_reach));
        if (a * a + b * b > steepest * steepest) reaches[bin] = below_surface;
        if (own.count == 0.0) continue;
        const double plants = std::max(plants_spread * noise[ring], plants_least);
        const auto spread = [](const Spread& of, double least) { return of.scatter > least * least * of.count; };
        if (own.rising < own_share * own.count && !spread(own, plants)) continue;
        Spread all = own;
        for (Index r = std::max(ring - 1, Index{0}); r < std::min(ring + 2, rings.count); ++r) {
            for (Index turn = -1; turn <= 1; ++turn) {
                const Index other = r * bin_columns + (bin % bin_columns + turn + bin_columns) % bin_columns;
                if (other == bin) continue;
                all.count += spreads[other].count;
                all.rising += spreads[other].rising;
                all.scatter += spreads[other].scatter;
            }
        }
        if (all.rising >= plants_share * all.count && spread(all, plants)) reaches[bin] = below_surface;
    }
}

// ---- Measures of places ----

// The spread of the ground, m, where there is none, and the number of points that it has there.
constexpr double usual_spread = 0.03, usual_points = 0.5;

// Adds to every bin half of those beside it, outwards and around; the sum of the weights is one.
template <class T>
void smooth(Scratch<T>& places) {
    const Index rings = places.count() / bin_columns;
    Scratch<T> inner(bin_columns), own(bin_columns), row(bin_columns + 2);
    for (Index ring = 0; ring < rings; ++ring) {
        T* const here = &places[ring * bin_columns];
        std::copy_n(here, bin_columns, own.begin());
        for (Index c = 0; c < bin_columns; ++c) {
            const T outer = ring + 1 < rings ? here[bin_columns + c] : T{};
            row[c + 1] = 0.5 * own[c] + 0.25 * (inner[c] + outer);
        }
        row[0] = row[bin_columns];  // a bin at each end stands for the one at the other
        row[bin_columns + 1] = row[1];
        for (Index c = 0; c < bin_columns; ++c) here[c] = 0.5 * row[c + 1] + 0.25 * (row[c] + row[c + 2]);
        std::swap(inner, own);
    }
}

// Nearly the logarithm to base 2, see `BinRings`.
double about_log2(double x) { return BinRings::bits(x) / static_cast<double>(1 << 23) - 127.0; }

}  // namespace

Surface find_surface(
    const PlacedPoints& points, const BinRings& rings, Scratch<float>& heights, Scratch<float>& reaches) {
    auto& s = kept_memory<BinSums>();
    const Layers layers = find_layers(points, rings, s);
    const Tilt whole = fit_whole(layers);
    std::vector<Level> levels = fit_levels(layers, rings, whole);
    const bool hangs = find_heights(points, layers, levels.back(), heights, s) && whole.c > highest;
    find_reaches(rings, reaches, s);
    return {whole, std::move(levels.front()), hangs};
}

// Measures: shares of the points, as roots where they are few, the spread of the ground, the number of points, the
// distance.
void measure_places(
    const PlacedPoints& points, const Scratch<float>& heights, const Scratch<float>& reaches, float belly, float height,
    Array<float, 2> out) {
    auto& [ground, others] = kept_memory<PlaceSums>();
    renew(ground, out.shape[0]);
    renew(others, out.shape[0]);
    for (Index i = 0; i < points.count(); ++i) {
        const Index bin = points.place[i].bin;
        const float h = heights[i];
        if (below_surface < h && h < reaches[bin]) {
            add_exact(ground[bin], Four{1.0, h, static_cast<double>(h) * h, 0.0});
        } else {
            others[bin] +=
                Four{h <= belly ? 1.0 : 0.0, h > belly && h < height ? 1.0 : 0.0, h < height ? 0.0 : 1.0, 0.0};
        }
    }
    smooth(ground);
    smooth(others);
    Scratch<double> ground_about(out.shape[0]);
    for (Index bin = 0; bin < out.shape[0]; ++bin) {
        const Four& own = ground[bin];
        const double count = own[near], low = others[bin][0], standing = others[bin][1], over = others[bin][2];
        const double all = count + low + standing + over + 1e-3;
        const double variance =
            (scatter_of(own) + usual_points * usual_spread * usual_spread) / (count + usual_points) + 1e-6;
        const std::array<double, place_measures> measures{
            std::sqrt(low / all),
            std::sqrt(standing / all),
            std::sqrt(over / all),
            count / all,
            0.15 * about_log2(variance),
            0.3 * about_log2(all),
            0.3 * static_cast<double>(bin / bin_columns) / octave_rings};
        for (std::size_t k = 0; k < place_measures; ++k)
            out(bin, static_cast<Index>(k)) = static_cast<float>(measures[k]);
        ground_about[bin] = count;
    }
    smooth(ground_about);
    for (Index bin = 0; bin < out.shape[0]; ++bin) out(bin, place_measures) = static_cast<float>(ground_about[bin]);
}

}  // namespace bumpy
