#pragma once
// Where images end up: linear float32 layers, row 0 at the top, and the files made of them.

#include <shadelab/features.hpp>

#include <filesystem>
#include <string>
#include <vector>

namespace shadelab {

struct Layer {
    std::string name;
    int channels;
    std::vector<float> data;  ///< rows from the top, pixels from the left, channels interleaved

    float* pixel(size_t index) { return &data[index * channels]; }
    const float* pixel(size_t index) const { return &data[index * channels]; }
};

/// The layers in the order in which files hold them:
/// total (RGB); with term layers: ambient, diffuse, specular (RGB each), coverage (0..1); with geometry layers, which are those
/// of the surface at the pixel's centre whatever the sample count: id (object number from 1, 0 = background),
/// depth (0..1, as OpenGL's window depth), normal (unit, world) and position (world).
/// With depth_only: depth. With visibility: for each sample s triangle.s (number over the scene from 1, 0 = none), then depth.s.
struct Film {
    int width, height;
    std::vector<Layer> layers;

    Film(int width, int height, const Features& features, glm::dvec3 background, int samples = 1);
    Layer* find(const std::string& name) {
        for (Layer& layer : layers)
            if (layer.name == name) return &layer;
        return nullptr;
    }
    const Layer* find(const std::string& name) const { return const_cast<Film*>(this)->find(name); }
    int channel_count() const;
    /// Averages n x n pixels into one. Geometry layers are not averaged: the sub-pixel nearest the centre stands.
    Film downsampled(int n) const;
};

/// Writes by extension: .png (sRGB, total times 2^exposure; pixels with NaN or negative infinity become magenta, positive
/// infinity white; with further layers one file each, NAME.LAYER.png), .exr (linear float32, named layers) or .npy (height x
/// width x channels, float32). Throws InputError for an unknown extension and InfrastructureError when writing fails.
void write_film(const Film& film, const std::filesystem::path& file, double exposure);

}  // namespace shadelab
