// Stages 2 and 4: clipping, projection, and which triangle each sample sees.
#include <shadelab/pipeline.hpp>

#include "clones.hpp"
#include "rasterize.hpp"

#include <algorithm>
#include <cmath>

namespace shadelab {

namespace {

constexpr int subpixels = 1 << subpixel_bits;
// With films of up to 16384 pixels, coordinates stay below 2^23 sub-pixels and the edge functions inside a tile below 2^31.
constexpr float guard_pixels = 8192;

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

/// Edge function of u -> v as A x + B y + C >= 0 over whole pixels relative to the tile, for a sample at (dx, dy).
struct Edge {
    int32_t a, b, c;
};

/// 0: the edge rejects the whole tile; 1: it crosses it; 2: the tile is inside (the edge is then constant zero).
inline int set_edge(const ScreenVertex& u, const ScreenVertex& v, glm::ivec2 origin, glm::ivec2 sample, Edge& edge) {
    const int64_t dx = v.x - u.x, dy = v.y - u.y;
    const int64_t ux = u.x - int64_t(origin.x) * subpixels - sample.x,
                  uy = u.y - int64_t(origin.y) * subpixels - sample.y;
    // Counter-clockwise with y upwards: left edges run down, bottom edges run right. Those own the samples on them.
    const bool owns = dy < 0 || (dy == 0 && dx > 0);
    // Pixels lie 256 sub-pixels apart, so the sign only depends on the floor of the constant over 256.
    const int64_t c = (dy * ux - dx * uy - (owns ? 0 : 1)) >> subpixel_bits;
    const int64_t reach_x = -dy * (tile_size - 1), reach_y = dx * (tile_size - 1);
    if (c + std::max<int64_t>(reach_x, 0) + std::max<int64_t>(reach_y, 0) < 0) return 0;
    if (c + std::min<int64_t>(reach_x, 0) + std::min<int64_t>(reach_y, 0) >= 0) {
        edge = {0, 0, 0};
        return 2;
    }
    edge = {int32_t(-dy), int32_t(dx), int32_t(c)};
    return 1;
}

/// The loops over a triangle's bounding box in one tile, for one sample position. Depth is a plane equation: its constant is
/// computed in double at the first pixel of every row, so the error is that of at most 63 float steps.
[[gnu::always_inline]] inline void rasterize_inline(const ScreenTriangle& t, glm::ivec2 origin, glm::ivec2 sample,
                                                    float* depth, uint32_t* triangle) {
    ScreenVertex v0 = t.vertex[0], v1 = t.vertex[1], v2 = t.vertex[2];
    const int64_t doubled_area = int64_t(v1.x - v0.x) * (v2.y - v0.y) - int64_t(v2.x - v0.x) * (v1.y - v0.y);
    if (doubled_area < 0) std::swap(v1, v2);  // back faces are drawn as well: a scene may look inside an open mesh
    Edge e0, e1, e2;
    if (!set_edge(v1, v2, origin, sample, e0) || !set_edge(v2, v0, origin, sample, e1) ||
        !set_edge(v0, v1, origin, sample, e2))
        return;

    const int left = std::min({v0.x, v1.x, v2.x}) - sample.x, right = std::max({v0.x, v1.x, v2.x}) - sample.x;
    const int bottom = std::min({v0.y, v1.y, v2.y}) - sample.y, top = std::max({v0.y, v1.y, v2.y}) - sample.y;
    const int x0 = std::max(((left + subpixels - 1) >> subpixel_bits) - origin.x, 0) & ~7;
    const int x1 = std::min((right >> subpixel_bits) - origin.x, tile_size - 1);
    const int y0 = std::max(((bottom + subpixels - 1) >> subpixel_bits) - origin.y, 0);
    const int y1 = std::min((top >> subpixel_bits) - origin.y, tile_size - 1);

    const double scale = 1.0 / double(std::abs(doubled_area));
    const double z10 = double(v1.z) - v0.z, z20 = double(v2.z) - v0.z;
    const double dzdx_sub = (z10 * (v2.y - v0.y) - z20 * (v1.y - v0.y)) * scale;  // per sub-pixel
    const double dzdy_sub = (z20 * (v1.x - v0.x) - z10 * (v2.x - v0.x)) * scale;
    const float dzdx = float(dzdx_sub * subpixels);
    const float z_min = std::min({v0.z, v1.z, v2.z}), z_max = std::max({v0.z, v1.z, v2.z});
    // Whole groups of eight pixels, and the compiler can see it: no loop for the rest. Pixels beyond the bounding box fail an
    // edge; the tile is a multiple of eight wide.
    const int width = (x1 - x0 + 8) & ~7;
    const uint32_t number = t.triangle;  // a copy: the ids that are written could otherwise alias it
    const double start_x = double((origin.x + x0) * subpixels + sample.x - v0.x);

    for (int y = y0; y <= y1; ++y) {
        const float z_row =
            float(v0.z + dzdx_sub * start_x + dzdy_sub * double((origin.y + y) * subpixels + sample.y - v0.y));
        const int32_t r0 = e0.c + e0.b * y + e0.a * x0, r1 = e1.c + e1.b * y + e1.a * x0,
                      r2 = e2.c + e2.b * y + e2.a * x0;
        float* z_at = depth + y * tile_size + x0;
        uint32_t* id_at = triangle + y * tile_size + x0;
        for (int i = 0; i < width; ++i) {
            const int32_t outside = (r0 + e0.a * i) | (r1 + e1.a * i) | (r2 + e2.a * i);
            float z = z_row + dzdx * float(i);
            z = z < z_min ? z_min : z;  // slivers: the plane may leave the triangle's own range by rounding
            z = z > z_max ? z_max : z;
            const bool nearer = (outside >= 0) & (z < z_at[i]);
            z_at[i] = nearer ? z : z_at[i];
            id_at[i] = nearer ? number : id_at[i];
        }
    }
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
    const auto to_grid = [](float ndc, int size) {
        // Scale and offset as one rounding (double, then float), then onto the grid in float32: llvmpipe's own steps.
        const float window = float(double(ndc) * (size * 0.5) + size * 0.5);
        return int32_t(std::nearbyint((window - 0.5f) * float(subpixels)));
    };
    // Only at corners that clipping made can rounding leave the range; OpenGL clamps there too.
    const float depth = std::clamp(float(double(clip.z / clip.w) * 0.5 + 0.5), 0.0f, 1.0f);
    return {to_grid(clip.x / clip.w, width), to_grid(clip.y / clip.w, height), depth};
}

unsigned clip_code(glm::vec4 p, int width, int height) {
    if (!(std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z) && std::isfinite(p.w))) return clip_not_finite;
    const float guard_x = 1 + 2 * guard_pixels / float(width), guard_y = 1 + 2 * guard_pixels / float(height);
    unsigned code = 0;
    if (p.z < -p.w) code |= clip_near;
    if (p.z > p.w) code |= clip_far;
    if (std::abs(p.x) > guard_x * p.w) code |= clip_guard_x;
    if (std::abs(p.y) > guard_y * p.w) code |= clip_guard_y;
    if (p.x < -p.w) code |= outside_left;
    if (p.x > p.w) code |= outside_right;
    if (p.y < -p.w) code |= outside_bottom;
    if (p.y > p.w) code |= outside_top;
    return code;
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

void rasterize(const ScreenTriangle& triangle, glm::ivec2 origin, int samples, VisibilityTile& tile) {
    const uint32_t one = 0;
    rasterize_list(&triangle, &one, 1, origin, samples, tile);
}

SHADELAB_CLONES
void rasterize_list(const ScreenTriangle* triangles, const uint32_t* list, size_t count, glm::ivec2 origin, int samples,
                    VisibilityTile& tile) {
    const std::vector<glm::ivec2>& positions = sample_positions(samples);
    for (size_t i = 0; i < count; ++i)
        for (int s = 0; s < samples; ++s) {
            const size_t plane = size_t(s) * tile_size * tile_size;
            rasterize_inline(triangles[list[i]], origin, positions[s], &tile.depth[plane], &tile.triangle[plane]);
        }
}

}  // namespace shadelab
