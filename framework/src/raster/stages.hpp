#pragma once
// What the stages of draw() hand to one another; pipeline.hpp shows the whole.

#include <shadelab/pipeline.hpp>

#include <algorithm>
#include <cstdint>
#include <vector>

namespace shadelab {

/// An array that a model names: a component of what a fragment holds, or a member of the material.
struct BatchColumn {
    enum Source { normal, position, eye, material } source;
    int component;  ///< of a material: the place in DrawnObject::constants
};

/// One object as the stages see it. Its vertices and triangles are numbered over the whole scene, from first_* on.
template <class Real>
struct DrawnObject {
    const Object* object;
    const Mesh* mesh;
    uint32_t first_vertex, first_triangle;

    glm::mat4 clip_from_object;      ///< float32 for both Reals: coverage must not depend on it
    double pixel_from_object[4][4];  ///< columns; gives homogeneous pixel coordinates (x w, y w, w) and clip z
    Real world_from_object[4][4];
    Real normal_from_object[3][4];
    bool unit_normals;  ///< normal_from_object keeps lengths, so that unit normals stay unit
    bool normals_can_cancel;
    Real orientation;  ///< -1 when to_world mirrors

    const plugin::Model<Real>* model = nullptr;
    std::vector<Real> material;
    std::vector<BatchColumn> columns;              ///< what the model takes of a batch, in its order
    std::vector<Real> constants;                   ///< a batch's array for each column that is a member of the material
    std::vector<glm::vec<3, Real>> lights_within;  ///< positions of the lights inside of its bounding box
    std::vector<std::array<Real, 12>> colour;      ///< Gouraud: total, ambient, diffuse, specular at each vertex
};

template <class Real>
struct Frame {
    const Scene& scene;
    const Features& features;
    const plugin::Table<Real>* plugin;  ///< null when nothing is shaded
    Film& film;
    std::vector<DrawnObject<Real>> objects;
    std::vector<std::vector<Real>> lights;  ///< flattened, in the order of features.lights
    glm::vec<3, Real> eye;
    int layers_out;  ///< 3 (total) or 12 (with the terms)

    const DrawnObject<Real>& object_of(uint32_t triangle) const {
        const auto after =
            std::upper_bound(objects.begin(), objects.end(), triangle,
                             [](uint32_t t, const DrawnObject<Real>& object) { return t < object.first_triangle; });
        return *(after - 1);
    }
};

/// A vertex as shading sees it.
template <class Real>
struct Corner {
    /// Homogeneous: x w, y w, w; clip z. In double: a float's last bit, 1/16384 pixel on a large film, would be most of the
    /// error of what is interpolated over a small triangle.
    alignas(32) double pixel[4];
    alignas(32) Real row[8];  ///< unit normal, 1 (so that interpolating it gives the weights' sum), world position, 0
    glm::vec<3, Real> normal() const { return {row[0], row[1], row[2]}; }
    glm::vec<3, Real> position() const { return {row[4], row[5], row[6]}; }
};

template <class Real>
Corner<Real> corner(const DrawnObject<Real>& object, uint32_t vertex);

/// Window depth of a triangle (the object's number for it) at a point of the film in pixels, without the roundings of the
/// rasterizer: the reference's depth layer.
double exact_depth(const DrawnObject<double>& object, uint32_t triangle, double x, double y);

// ------------------------------------------------------------------------------------------------- stages 1 to 3

struct TileGrid {
    int width, height, across, down;
    TileGrid(int width, int height)
        : width(width),
          height(height),
          across((width + tile_size - 1) / tile_size),
          down((height + tile_size - 1) / tile_size) {}
    glm::ivec2 origin(int tile) const { return {tile % across * tile_size, tile / across * tile_size}; }
};

/// The triangles of one stretch of the scene, listed by tile. Stretches follow one another in the scene's order and are
/// visited in it, so the first of equal depths, and with it the image, does not depend on how many there are.
struct Stretch {
    static constexpr uint32_t is_piece = 0x80000000;
    /// Twice per tile, front faces and then back faces: a triangle's number, or is_piece + a place in `pieces`. Whatever faces
    /// away is drawn when what faces the camera stands, and is mostly hidden then.
    std::vector<std::vector<uint32_t>> bins;
    std::vector<ScreenTriangle> pieces;  ///< what clipping left of triangles
};

/// What draw() keeps from frame to frame (Workspace).
struct Buffers {
    std::vector<ScreenVertex> screen;
    std::vector<uint16_t> codes;
    std::vector<Stretch> stretches;
};

/// Stages 1 to 3. `spread`: how far samples lie from pixel centres, in sub-pixels.
template <class Real>
void bin_scene(const std::vector<DrawnObject<Real>>& objects, const TileGrid& grid, int spread, Buffers& buffers,
               DrawStatistics& statistics);

// ------------------------------------------------------------------------------------------------- stages 4 and 5

/// What one tile sees: stage 4's samples, in which triangles are numbered by their place in `triangles`.
struct TileView {
    VisibilityTile samples;
    std::vector<uint32_t> triangles;  ///< numbers over the scene
    struct Range {
        uint32_t first;  ///< place of the object's first triangle in `triangles`
        uint32_t object;
    };
    std::vector<Range> ranges;
};

struct Fragment {
    uint16_t x, y;   ///< pixel of the tile
    uint32_t place;  ///< in TileView::triangles
    float weight;    ///< share of the pixel's samples that it covers
};

/// The fragments of a tile.
struct Fragments {
    std::vector<Fragment> list;  ///< as long as was ever needed
    size_t count = 0;
    bool full = false;  ///< every pixel is covered whole, by one triangle
};

/// Stage 4 for a tile: front faces in the scene's order, then back faces. Ids: whether it is asked who is nearest.
template <bool Ids, class Real>
void see(const Frame<Real>& frame, const Buffers& buffers, const TileGrid& grid, int tile,
         const std::vector<glm::ivec2>& samples, TileView& view);

/// The distinct triangles that each pixel of a tile sees, with the share of its samples, row by row.
void collect_fragments(const TileView& view, int samples, glm::ivec2 origin, const TileGrid& grid, Fragments& out);

/// Attributes over the pixels, times the sum of the perspective weights: value = c + x dx + y dy from an anchor pixel. A row of
/// eight is what a vector register holds: n.xyz, the sum itself, x.xyz, 0.
template <class Real>
struct Planes {
    alignas(32) Real c[8], x[8], y[8];
    uint16_t anchor_x, anchor_y;
};

/// Turns the fragments of a tile into batches.
template <class Real>
class Interpolator {
public:
    explicit Interpolator(const Frame<Real>& frame) : frame_(frame) {}
    void begin_tile(const TileView& view, glm::ivec2 origin);
    /// Fills a batch from fragments of one object. Returns how many normals had to be replaced by the face normal.
    int64_t interpolate(const DrawnObject<Real>& object, const Fragment* fragments, int count,
                        FragmentBatch<Real>& batch);
    /// Fills in what interpolate() left out of the batch because nobody needs it: for reports of values that are not finite.
    int64_t surface(const DrawnObject<Real>& object, const Fragment* fragments, FragmentBatch<Real>& batch, bool view);

private:
    uint32_t make_planes(const DrawnObject<Real>& object, const Fragment& fragment);

    const Frame<Real>& frame_;
    const TileView* view_ = nullptr;
    glm::ivec2 origin_{0};
    std::vector<uint32_t> slots_;  ///< per place in the view: where its planes stand
    std::vector<Planes<Real>> planes_, colour_planes_;
    std::vector<Real> rows_, squared_;
};

}  // namespace shadelab
