#pragma once
// The frame packet: everything an OpenGL client needs to draw a scene except the student's GLSL. Clients (the grader's, the
// benchmark's, a viewer, a browser) upload, draw and read back; they know no scene, no layer, no light and no model.

#include <shadelab/features.hpp>
#include <shadelab/manifest.hpp>
#include <shadelab/mesh.hpp>

#include <filesystem>
#include <string>

namespace shadelab {

/// The file: the line "shadelab packet 2", the length of the header in bytes as a line, the header (JSON), then the buffers
/// (little-endian float32 and uint32). Every `offset` counts bytes from the first one behind the header, `count` counts elements.
///
///     width, height   of the targets, pixels: the film's times supersample
///     supersample     how many of these make a pixel of the film, in each direction
///     glsl            version ("330") and precision (statements that stand behind #version, or "")
///     sources         texts that several stages share, by name
///     programs[]      vertex, fragment: lists of pieces, each with `line`, the number of its first line, and one of
///                     `text`, `source` (a name) and `student` (true: the student's file stands here)
///     textures[]      name (of the sampler), offset, width, height: RGBA float32, nearest; texture i is bound to unit i
///     uniforms        what all objects share: name -> numbers, float32, matrices by column
///     objects[]       attributes: name -> offset, count (of vertices), components (float32 each)
///                     indices: offset, count: triangles, three uint32 each
///                     uniforms: name -> numbers, as above;  to_world: 16 numbers by column, in double
///     camera          eye, world_to_clip (16 numbers by column, in double)
///     passes[]        name;  samples: coverage and depth samples of a pixel
///                     targets[]: RGBA float32, bound to the outputs 0, 1, ... in order: layer (for people), clear (four numbers)
///                     draws[]: object, program (numbers of the lists above), in this order
///     film[]          the image's layers in their order: layer, channels, pass, target, first, reduce
///
/// A stage is "#version V", the precision, and each piece behind its own "#line N", so that a line in a driver's message tells
/// the piece. A browser puts its own version and precision there.
///
/// A pass clears its targets and the depth (to 1), and draws with the depth test "less", depth writes, no culling, no blending.
/// A program need not have every attribute, uniform and sampler: compilers drop what a student's function does not read. Samples
/// are averaged when the pass is over.
///
/// A layer of the film is `channels` components of a target, from component `first` on. Target -1 is the pass's depth, of each
/// pixel's first sample. Of the supersample^2 pixels that make one of the film, "mean" takes the average (summed in double), and
/// "centre" the one in column and row supersample / 2, rounded down and counted from the top left.
///
/// Who moves the camera sets shadelab_to_clip to float32(world_to_clip to_world) for each object, the product in double, and
/// shadelab_eye to the new eye; nothing else depends on the camera.
struct Packet {
    std::string header;   ///< JSON
    std::string buffers;  ///< what the offsets point into
};

/// Throws InputError for a scene that OpenGL clients cannot draw.
Packet make_packet(const Scene& scene, const Manifest& manifest, const Features& features,
                   const std::vector<Mesh>& meshes, int supersample, const std::filesystem::path& framework);
void write_packet(const Packet& packet, const std::filesystem::path& file);

}  // namespace shadelab
