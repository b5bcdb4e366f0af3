#pragma once
// The whole machine on one screen. A frame passes through the types below in the order in which they stand:
//
//   Mesh ──1,2──► ScreenVertex ──3──► bins ──4──► VisibilityTile ──5──► FragmentBatch ──6──► Film
//
//   1  vertices are transformed to clip space
//   2  and projected onto an 8-bit sub-pixel grid; triangles that leave it, or the near or far plane, are clipped
//   3  each triangle's number is listed in the 64 x 64 tiles that it touches, front faces apart from back faces
//   4  per tile, the nearest triangle of every sample is found: visibility first
//   5  only what is visible is interpolated, in batches of one material (structure of arrays)
//   6  the student's function shades a batch, one light at a time: I(a + b) = I(a) + I(b)
//
// The code stands in src/raster: bin.cpp (1 to 3), rasterize.cpp and visibility.cpp (2 and 4), fragments.cpp (5); and in
// src/frame/draw.cpp (6 and the frame as a whole). docs/rasterizer.md says why it is fast.
//
// Conventions are OpenGL's: clip space with z in [-w, w], window y upwards, pixel centres at half-integers, depth in [0, 1],
// nearer is smaller. Only Film counts rows from the top. Coverage is decided in integers, so that two triangles that share an
// edge never both cover a sample or both miss it; a sample exactly on an edge belongs to the triangle whose left or bottom edge
// it is, which is what llvmpipe does. `Real` is float, or double for the reference; coverage is the same in both.

#include <shadelab/features.hpp>
#include <shadelab/film.hpp>
#include <shadelab/mesh.hpp>
#include <shadelab/plugin.hpp>

#include <glm/glm.hpp>

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace shadelab {

inline constexpr int tile_size = 64;
inline constexpr int subpixel_bits = 8;
inline constexpr uint32_t no_triangle = 0xffffffff;

/// After stage 2. x and y in 1/256 pixel, relative to the centre of the bottom-left pixel; z is window depth. What rounding to
/// the grid took away is kept for the depth plane, in 1/32768 of a grid step.
struct ScreenVertex {
    int32_t x, y;
    float z;
    int16_t residual_x = 0, residual_y = 0;
    double exact_x() const { return x + residual_x * 0x1p-15; }
    double exact_y() const { return y + residual_y * 0x1p-15; }
};
struct ScreenTriangle {
    ScreenVertex vertex[3];
    uint32_t triangle;  ///< number of the mesh triangle that it is (a part of), counted over all objects of the scene
};

/// Stage 4's result: for every sample of a tile the depth and the number of the nearest triangle. A struct of plain arrays,
/// one plane per sample, so that the inner loop runs over eight pixels of a row at a time.
struct VisibilityTile {
    std::vector<float> depth;        ///< samples x 64 x 64
    std::vector<uint32_t> triangle;  ///< the same; no_triangle where nothing is
};

/// Stage 5's result: what the student's function takes. All fragments of a batch belong to one object.
template <class Real>
struct FragmentBatch {
    static constexpr int capacity = 1024;
    int count = 0;
    int pixel[capacity];     ///< index into the film
    float weight[capacity];  ///< share of the pixel's samples that it covers
    // What interface.toml's attributes come from; a model is handed the arrays that it names.
    alignas(64) Real normal[3][capacity];
    alignas(64) Real position[3][capacity];
    alignas(64) Real eye[3][capacity];   ///< the unit vector to it
    alignas(64) Real out[12][capacity];  ///< total, ambient, diffuse, specular
};

/// Offsets of the samples from the pixel's centre in 1/256 pixel. 1, 2 and 4 as OpenGL implementations place them.
const std::vector<glm::ivec2>& sample_positions(int samples);

/// Clips against near, far and a guard band (beyond it the fixed-point grid ends) and projects; 0 to 7 triangles.
/// Exposed for tests; draw() calls it for the few triangles that need it.
void clip_and_project(const glm::vec4 clip[3], int width, int height, uint32_t triangle,
                      std::vector<ScreenTriangle>& out);
/// The projection alone, for a vertex inside the frustum.
ScreenVertex project(glm::vec4 clip, int width, int height);
/// Stage 4 for one triangle; `origin` is the tile's bottom-left pixel.
void rasterize(const ScreenTriangle& triangle, glm::ivec2 origin, int samples, VisibilityTile& tile);

/// Where a value that is not finite first stood (topmost, then leftmost pixel), and what went into it.
struct NotFinite {
    int x, y;
    std::string material, model;
    glm::dvec3 n, position, v, value;
};

struct DrawStatistics {
    int64_t triangles = 0, clipped_triangles = 0, not_finite_vertices = 0;
    int64_t fragments = 0;         ///< shaded
    int64_t fallback_normals = 0;  ///< interpolated normals that cancelled and became the face normal
    int64_t lights_at_surface =
        0;  ///< a light at the very point that is shaded: it has no direction, and gives nothing
    int64_t not_finite_fragments = 0;
    std::optional<NotFinite> first_not_finite;
    double vertex_ms = 0, bin_ms = 0, tile_ms = 0;
};

/// The x86-64 level whose code draw() runs: "v4", "v3", "v2", or "plain" (elsewhere, too). The best that the processor has, or
/// what the environment variable SHADELAB_LEVEL names. The image is the same to the last bit.
std::string processor_level();

/// Memory that draw() needs, for those who draw many frames.
struct Workspace {
    std::shared_ptr<void> buffers;
};

/// Draws the scene into the film, at the film's size. `meshes` holds one mesh per object. For term layers the plugin must have
/// been compiled with terms; one with terms serves a film without.
template <class Real>
DrawStatistics draw(const Scene& scene, const Features& features, const std::vector<Mesh>& meshes,
                    const plugin::Table<Real>& plugin, Film& film, Workspace* workspace = nullptr);

}  // namespace shadelab
