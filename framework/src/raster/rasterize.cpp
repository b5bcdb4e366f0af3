// Stages 2 and 4: clipping, projection, and which triangle each sample sees.
#include <shadelab/pipeline.hpp>

#include "raster/lanes.hpp"
#include "raster/rasterize.hpp"
#include "raster/stages.hpp"

#include <algorithm>
#include <cmath>

namespace shadelab {

namespace {

constexpr int subpixels = 1 << subpixel_bits;
// With films of up to 16384 pixels, coordinates stay below 2^23 sub-pixels and the edge functions inside a tile below 2^31.
constexpr float guard_pixels = 8192;
constexpr float grid_limit = float(1 << 24);
constexpr double residual_scale = 32768;  // of little more than half a sub-pixel at most: fits 16 bits

struct Plane {
    double x, y, z, w;
    double distance(glm::dvec4 p) const { return x * p.x + y * p.y + z * p.z + w * p.w; }
};

/// Sutherland-Hodgman against one plane. The intersection is always computed from the outside vertex, so that neighbours find
/// the same one, and in double: with corners 1e6 near distances away, float32 would put it behind the eye now and then.
int clip_polygon(const glm::dvec4* in, int count, Plane plane, glm::dvec4* out) {
    int kept = 0;
    for (int i = 0; i < count; ++i) {
        const glm::dvec4 a = in[i], b = in[(i + 1) % count];
        const double da = plane.distance(a), db = plane.distance(b);
        if (da >= 0) out[kept++] = a;
        if ((da >= 0) != (db >= 0)) {
            const glm::dvec4 inside = da >= 0 ? a : b, outside = da >= 0 ? b : a;
            const double t = (da >= 0 ? db : da) / ((da >= 0 ? db : da) - (da >= 0 ? da : db));
            out[kept++] = outside + t * (inside - outside);
        }
    }
    return kept;
}

/// A triangle about to be drawn into a tile. Pixels are counted from the tile's bottom-left one.
struct Placed {
    const ScreenVertex* v[3];  ///< counter-clockwise
    int32_t left, bottom;      ///< the tile's origin in sub-pixels
    int x0, x1, y0, y1;        ///< pixels that may hold a covered sample
    bool near;  ///< all corners lie within 2^15 sub-pixels of the origin, so that 32 bits hold every product
};

/// False when no sample of the tile can be covered. `spread`: how far samples lie from pixel centres, in sub-pixels.
[[gnu::always_inline]] inline bool place(const ScreenVertex& corner0, const ScreenVertex& corner1,
                                         const ScreenVertex& corner2, glm::ivec2 origin, int spread, Placed& out) {
    out.left = origin.x * subpixels, out.bottom = origin.y * subpixels;
    const int32_t x_min = std::min(std::min(corner0.x, corner1.x), corner2.x) - out.left;
    const int32_t x_max = std::max(std::max(corner0.x, corner1.x), corner2.x) - out.left;
    const int32_t y_min = std::min(std::min(corner0.y, corner1.y), corner2.y) - out.bottom;
    const int32_t y_max = std::max(std::max(corner0.y, corner1.y), corner2.y) - out.bottom;
    out.x0 = std::max((x_min - spread + subpixels - 1) >> subpixel_bits, 0);
    out.x1 = std::min((x_max + spread) >> subpixel_bits, tile_size - 1);
    out.y0 = std::max((y_min - spread + subpixels - 1) >> subpixel_bits, 0);
    out.y1 = std::min((y_max + spread) >> subpixel_bits, tile_size - 1);
    if (out.x0 > out.x1 || out.y0 > out.y1) return false;
    out.near = std::min(x_min, y_min) >= -(1 << 15) && std::max(x_max, y_max) < (1 << 15);

    const int64_t doubled_area = int64_t(corner1.x - corner0.x) * (corner2.y - corner0.y) -
                                 int64_t(corner2.x - corner0.x) * (corner1.y - corner0.y);
    // Back faces are drawn as well: a scene may look inside an open mesh.
    out.v[0] = &corner0;
    out.v[1] = doubled_area < 0 ? &corner2 : &corner1;
    out.v[2] = doubled_area < 0 ? &corner1 : &corner2;
    return doubled_area != 0;
}

/// Depth over the pixels. The plane goes through the corners where they were before they were put onto the grid: half a
/// sub-pixel would tilt a small triangle's depth by more than a float's last bits. In double: a float's plane is 200 ulp off.
struct DepthPlane {
    double start, dzdx, dzdy;  ///< at the centre of pixel (x0, 0), and per pixel
    float low, high;           ///< the corners' range; with slivers the plane may leave it by rounding
};

[[gnu::always_inline]] inline DepthPlane depth_plane(const Placed& t) {
    const ScreenVertex &v0 = *t.v[0], &v1 = *t.v[1], &v2 = *t.v[2];
    const double x0 = v0.exact_x(), y0 = v0.exact_y();
    const double x10 = v1.exact_x() - x0, x20 = v2.exact_x() - x0, y10 = v1.exact_y() - y0, y20 = v2.exact_y() - y0;
    const double z10 = double(v1.z) - v0.z, z20 = double(v2.z) - v0.z;
    const double area = x10 * y20 - x20 * y10, scale = area != 0 ? subpixels / area : 0.0;
    DepthPlane out;
    out.dzdx = (z10 * y20 - z20 * y10) * scale;
    out.dzdy = (z20 * x10 - z10 * x20) * scale;
    out.start = v0.z + (out.dzdx * (t.left + t.x0 * subpixels - x0) + out.dzdy * (t.bottom - y0)) * (1.0 / subpixels);
    out.low = std::min(std::min(v0.z, v1.z), v2.z);
    out.high = std::max(std::max(v0.z, v1.z), v2.z);
    return out;
}

// An edge function is A x + B y + C >= 0 inside. With y upwards left edges run down and bottom edges run right; those own the
// samples on them, the others' constants are one less. At whole pixels the sign only depends on the floor of C over 256.

/// One group of pixels in a row: what is covered and nearer takes the place of what is there. The depth of a row is rounded once
/// from double, at x0; what follows are at most 63 float steps, counted from x0 whatever the width of a group.
template <bool Ids>
[[gnu::always_inline]] inline void draw_group(ints edges, floats z, const DepthPlane& plane, ints number, float* depth,
                                              uint32_t* triangle) {
    const floats low = floats{} + plane.low, high = floats{} + plane.high, old = load<floats>(depth);
    z = z < low ? low : z;
    z = z > high ? high : z;
    const ints nearer = (edges >= 0) & (z < old);
    store(depth, nearer ? z : old);
    if constexpr (Ids) store(triangle, nearer ? number : load<ints>(triangle));
}

/// A triangle that is near and at most two groups wide: all three edges are set up at once.
template <bool Ids>
[[gnu::always_inline]] inline void fill_narrow(const Placed& t, const std::vector<glm::ivec2>& samples, uint32_t id,
                                               float* depth, uint32_t* triangle) {
    const int4 x = {t.v[0]->x - t.left, t.v[1]->x - t.left, t.v[2]->x - t.left, 0};
    const int4 y = {t.v[0]->y - t.bottom, t.v[1]->y - t.bottom, t.v[2]->y - t.bottom, 0};
    const int4 next = {1, 2, 0, 3};
    const int4 dx = __builtin_shuffle(x, next) - x, dy = __builtin_shuffle(y, next) - y;
    const int4 owns = (dy < 0) | ((dy == 0) & (dx > 0));
    const int4 constant = dy * x - dx * y + ~owns;  // true is -1
    const DepthPlane plane = depth_plane(t);
    const float dzdx = float(plane.dzdx);

    const int first = t.x0 & ~(lanes - 1);
    const ints lane = counting(), number = ints{} + int32_t(id);
    const ints a0 = ints{} - dy[0], a1 = ints{} - dy[1], a2 = ints{} - dy[2];
    const ints along0 = a0 * lane, along1 = a1 * lane, along2 = a2 * lane;
    const floats z_along = to_floats(lane + (first - t.x0)) * dzdx;
    for (const glm::ivec2 sample : samples) {
        const int4 at_start = ((constant - dy * sample.x + dx * sample.y) >> subpixel_bits) - dy * first + dx * t.y0;
        ints e0 = along0 + at_start[0], e1 = along1 + at_start[1], e2 = along2 + at_start[2];
        double z_row =
            plane.start + plane.dzdy * t.y0 + (plane.dzdx * sample.x + plane.dzdy * sample.y) * (1.0 / subpixels);
        for (int y_at = t.y0; y_at <= t.y1; ++y_at) {
            const int row = y_at * tile_size + first;
            const float z_start = float(z_row);
            draw_group<Ids>(e0 | e1 | e2, z_along + z_start, plane, number, depth + row, triangle + row);
            if (first + lanes <= t.x1)
                draw_group<Ids>((e0 + a0 * lanes) | (e1 + a1 * lanes) | (e2 + a2 * lanes),
                                to_floats(lane + (first + lanes - t.x0)) * dzdx + z_start, plane, number,
                                depth + row + lanes, triangle + row + lanes);
            e0 += dx[0], e1 += dx[1], e2 += dx[2];
            z_row += plane.dzdy;
        }
        depth += tile_size * tile_size;
        triangle += tile_size * tile_size;
    }
}

/// Narrows [first, last] to the pixels of a row in which a x + r >= 0 can hold. Conservative: rounding costs a pixel, never one
/// that is inside.
inline void narrow(int32_t a, int32_t r, float inverse, int& first, int& last) {
    if (a == 0) return;
    const float zero = std::clamp(-float(r) * inverse, -2.0f, float(tile_size) + 2);
    if (a > 0)
        first = std::max(first, int(zero) - 1);
    else
        last = std::min(last, int(zero) + 2);
}

/// Any triangle. An edge that has the whole tile inside becomes constant zero, so that what is left fits 32 bits.
template <bool Ids>
[[gnu::always_inline]] inline void fill_wide(const Placed& t, const std::vector<glm::ivec2>& samples, uint32_t id,
                                             float* depth, uint32_t* triangle) {
    const DepthPlane plane = depth_plane(t);
    const float dzdx = float(plane.dzdx);
    const ints lane = counting(), number = ints{} + int32_t(id);
    for (const glm::ivec2 sample : samples) {
        int32_t a[3], b[3], c[3];
        float inverse[3];
        bool outside = false;
        for (int k = 0; k < 3; ++k) {
            const ScreenVertex &from = *t.v[k], &to = *t.v[k == 2 ? 0 : k + 1];
            const int64_t dx = to.x - from.x, dy = to.y - from.y;
            const bool owns = dy < 0 || (dy == 0 && dx > 0);
            const int64_t constant = dy * (from.x - t.left - sample.x) - dx * (from.y - t.bottom - sample.y) - !owns;
            const int64_t floor = constant >> subpixel_bits;
            const int64_t reach_x = -dy * (tile_size - 1), reach_y = dx * (tile_size - 1);
            outside |= floor + std::max<int64_t>(reach_x, 0) + std::max<int64_t>(reach_y, 0) < 0;
            const bool inside = floor + std::min<int64_t>(reach_x, 0) + std::min<int64_t>(reach_y, 0) >= 0;
            a[k] = inside ? 0 : int32_t(-dy), b[k] = inside ? 0 : int32_t(dx), c[k] = inside ? 0 : int32_t(floor);
            inverse[k] = 1.0f / float(a[k]);
        }
        const double z_sample = plane.start + (plane.dzdx * sample.x + plane.dzdy * sample.y) * (1.0 / subpixels);
        for (int y = t.y0; y <= t.y1 && !outside; ++y) {
            const int32_t r0 = c[0] + b[0] * y, r1 = c[1] + b[1] * y, r2 = c[2] + b[2] * y;
            int first = t.x0, last = t.x1;
            narrow(a[0], r0, inverse[0], first, last);
            narrow(a[1], r1, inverse[1], first, last);
            narrow(a[2], r2, inverse[2], first, last);
            const float z_row = float(z_sample + plane.dzdy * y);
            first &= ~(lanes - 1);
            ints e0 = lane * a[0] + (r0 + a[0] * first), e1 = lane * a[1] + (r1 + a[1] * first),
                 e2 = lane * a[2] + (r2 + a[2] * first), offset = lane + (first - t.x0);
            for (int x = first; x <= last; x += lanes) {
                const int at = y * tile_size + x;
                draw_group<Ids>(e0 | e1 | e2, to_floats(offset) * dzdx + z_row, plane, number, depth + at,
                                triangle + at);
                e0 += a[0] * lanes, e1 += a[1] * lanes, e2 += a[2] * lanes, offset += lanes;
            }
        }
        depth += tile_size * tile_size;
        triangle += tile_size * tile_size;
    }
}

template <bool Ids>
[[gnu::always_inline]] inline void draw_triangle(const ScreenVertex& v0, const ScreenVertex& v1, const ScreenVertex& v2,
                                                 uint32_t number, glm::ivec2 origin,
                                                 const std::vector<glm::ivec2>& samples, const FarthestDepth* farthest,
                                                 float* depth, uint32_t* triangle) {
    Placed t;
    if (!place(v0, v1, v2, origin, samples.size() > 1 ? subpixels / 2 : 0, t)) return;
    if (farthest && farthest->hides(t.x0, t.x1, t.y0, t.y1, std::min(std::min(v0.z, v1.z), v2.z))) return;
    if (t.near && t.x1 - (t.x0 & ~(lanes - 1)) < 2 * lanes)
        fill_narrow<Ids>(t, samples, number, depth, triangle);
    else
        fill_wide<Ids>(t, samples, number, depth, triangle);
}

}  // namespace

const std::vector<glm::ivec2>& sample_positions(int samples) {
    static const std::vector<std::vector<glm::ivec2>> patterns = [] {
        std::vector<std::vector<glm::ivec2>> out(7);
        out[0] = {{0, 0}};
        out[1] = {{64, 64}, {-64, -64}};
        // Rows counted upwards. llvmpipe's rows count from the film's first row, which its client draws last: the mirror image.
        out[2] = {{-32, -96}, {96, -32}, {-96, 32}, {32, 96}};
        for (int log2 = 3; log2 <= 6; ++log2) {
            // Hammersley points: every row and every column of an n x n grid holds one sample.
            const int n = 1 << log2;
            for (int i = 0; i < n; ++i) {
                int reversed = 0;
                for (int bit = 0; bit < log2; ++bit) reversed |= ((i >> bit) & 1) << (log2 - 1 - bit);
                const int step = subpixels / n;
                out[log2].push_back({i * step + step / 2 - subpixels / 2, reversed * step + step / 2 - subpixels / 2});
            }
        }
        return out;
    }();
    int log2 = 0;
    while ((1 << log2) < samples) ++log2;
    return patterns.at(size_t(log2));
}

ScreenVertex project(glm::vec4 clip, int width, int height) {
    ScreenVertex out;
    project(1, &clip.x, &clip.y, &clip.z, &clip.w, width, height, &out);
    return out;
}

void project(int count, const float* __restrict x, const float* __restrict y, const float* __restrict z,
             const float* __restrict w, int width, int height, ScreenVertex* __restrict out) {
    constexpr int block = 128;
    // 1.5 * 2^52: at this size doubles are one apart, so adding and subtracting it rounds to the nearest, ties to even.
    constexpr double anchor = 6755399441055744.0;
    const double half_width = width * 0.5, half_height = height * 0.5;
    for (int start = 0; start < count; start += block) {
        const int n = std::min(block, count - start);
        int32_t on_grid[2][block], residual[2][block];
        float depth[block];
        for (int axis = 0; axis < 2; ++axis) {
            const float* __restrict coordinate = (axis ? y : x) + start;
            const float* __restrict divisor = w + start;
            const double half = axis ? half_height : half_width;
            for (int i = 0; i < n; ++i) {
                // llvmpipe's own steps: times the reciprocal, scale and offset as one rounding (double, then float), then onto
                // the grid in float32.
                const float window = float(double(coordinate[i] * (1.0f / divisor[i])) * half + half);
                float grid = (window - 0.5f) * float(subpixels);
                grid = grid < grid_limit ? grid : grid_limit;  // of vertices that are to be clipped: any value does
                grid = grid > -grid_limit ? grid : -grid_limit;
                const double rounded = (double(grid) + anchor) - anchor;
                on_grid[axis][i] = int32_t(rounded);
                // What that took away, from the better quotient.
                const double exact = (double(coordinate[i] / divisor[i]) * half + half - 0.5) * subpixels;
                double lost = (exact - rounded) * residual_scale;
                lost = lost < residual_scale ? lost : residual_scale - 1;
                residual[axis][i] = int32_t(lost > -residual_scale ? lost : -residual_scale);
            }
        }
        for (int i = 0; i < n; ++i) {
            // Only at corners that clipping made can rounding leave the range; OpenGL clamps there too.
            const float d = float(double(z[start + i] / w[start + i]) * 0.5 + 0.5);
            depth[i] = d < 0.0f ? 0.0f : d > 1.0f ? 1.0f : d;
        }
        for (int i = 0; i < n; ++i)
            out[start + i] = {on_grid[0][i], on_grid[1][i], depth[i], int16_t(residual[0][i]), int16_t(residual[1][i])};
    }
}

unsigned clip_code(glm::vec4 p, int width, int height) {
    uint16_t code;
    clip_codes(1, &p.x, &p.y, &p.z, &p.w, width, height, &code);
    return code;
}

unsigned clip_codes(int count, const float* __restrict x, const float* __restrict y, const float* __restrict z,
                    const float* __restrict w, int width, int height, uint16_t* __restrict out) {
    const float guard_x = 1 + 2 * guard_pixels / float(width), guard_y = 1 + 2 * guard_pixels / float(height);
    unsigned any = 0;
    for (int i = 0; i < count; ++i) {
        const float sum = (x[i] - x[i]) + (y[i] - y[i]) + (z[i] - z[i]) + (w[i] - w[i]);
        unsigned code = 0;
        code |= z[i] < -w[i] ? unsigned(clip_near) : 0u;
        code |= z[i] > w[i] ? unsigned(clip_far) : 0u;
        code |= std::abs(x[i]) > guard_x * w[i] ? unsigned(clip_guard_x) : 0u;
        code |= std::abs(y[i]) > guard_y * w[i] ? unsigned(clip_guard_y) : 0u;
        code |= x[i] < -w[i] ? unsigned(outside_left) : 0u;
        code |= x[i] > w[i] ? unsigned(outside_right) : 0u;
        code |= y[i] < -w[i] ? unsigned(outside_bottom) : 0u;
        code |= y[i] > w[i] ? unsigned(outside_top) : 0u;
        code = sum == 0.0f ? code : unsigned(clip_not_finite);  // infinity - infinity and NaN - NaN are NaN
        out[i] = uint16_t(code);
        any |= code;
    }
    return any;
}

void clip_and_project(const glm::vec4 clip[3], int width, int height, uint32_t triangle,
                      std::vector<ScreenTriangle>& out) {
    const float guard_x = 1 + 2 * guard_pixels / float(width), guard_y = 1 + 2 * guard_pixels / float(height);
    const Plane planes[] = {{0, 0, 1, 1},        {0, 0, -1, 1},      {1, 0, 0, guard_x},
                            {-1, 0, 0, guard_x}, {0, 1, 0, guard_y}, {0, -1, 0, guard_y}};
    glm::dvec4 polygon[9] = {clip[0], clip[1], clip[2]}, next[9];
    int count = 3;
    for (const Plane& plane : planes) {
        count = clip_polygon(polygon, count, plane, next);
        std::copy(next, next + count, polygon);
        if (count < 3) return;
    }
    for (int k = 0; k < count; ++k)
        if (!(polygon[k].w > 0)) return;  // only a triangle through the eye itself: it has no picture
    const auto projected = [&](int k) { return project(glm::vec4(polygon[k]), width, height); };
    const ScreenVertex first = projected(0);
    for (int k = 1; k + 1 < count; ++k) out.push_back({{first, projected(k), projected(k + 1)}, triangle});
}

void FarthestDepth::update(const float* depth, size_t samples) {
    for (int y = 0; y < across; ++y)
        for (int x = 0; x < across; ++x) {
            floats most{};
            for (size_t s = 0; s < samples; ++s)
                for (int row = 0; row < block; ++row)
                    for (int k = 0; k < block; k += lanes) {
                        const size_t at = (s * tile_size + size_t(y * block + row)) * tile_size + size_t(x * block + k);
                        const floats z = load<floats>(depth + at);
                        most = z > most ? z : most;
                    }
            float farthest = 0;
            for (int k = 0; k < lanes; ++k) farthest = std::max(farthest, most[k]);
            block_depth[y * across + x] = farthest;
        }
}

void rasterize(const ScreenTriangle& t, glm::ivec2 origin, int samples, VisibilityTile& tile) {
    draw_triangle<true>(t.vertex[0], t.vertex[1], t.vertex[2], t.triangle, origin, sample_positions(samples), nullptr,
                        tile.depth.data(), tile.triangle.data());
}

template <bool Ids>
void rasterize(const TriangleList& list, glm::ivec2 origin, const std::vector<glm::ivec2>& samples,
               const FarthestDepth* farthest, uint32_t first_number, float* depth, uint32_t* triangle) {
    for (size_t i = 0; i < list.count; ++i) {
        const uint32_t entry = list.entries[i], number = first_number + uint32_t(i);
        if (entry & Stretch::is_piece) {
            const ScreenVertex* v = list.pieces[entry & ~Stretch::is_piece].vertex;
            draw_triangle<Ids>(v[0], v[1], v[2], number, origin, samples, farthest, depth, triangle);
        } else {
            const uint32_t* vertex = list.indices + 3 * size_t(entry);
            draw_triangle<Ids>(list.screen[vertex[0]], list.screen[vertex[1]], list.screen[vertex[2]], number, origin,
                               samples, farthest, depth, triangle);
        }
    }
}

template void rasterize<true>(const TriangleList&, glm::ivec2, const std::vector<glm::ivec2>&, const FarthestDepth*,
                              uint32_t, float*, uint32_t*);
template void rasterize<false>(const TriangleList&, glm::ivec2, const std::vector<glm::ivec2>&, const FarthestDepth*,
                               uint32_t, float*, uint32_t*);

}  // namespace shadelab
