#pragma once
// A scene as its file describes it: units and conventions of the file resolved (angles in radians, paths absolute, unit
// directions), every value checked, nothing loaded yet.

#include <shadelab/manifest.hpp>

#include <glm/glm.hpp>

#include <filesystem>
#include <string>
#include <vector>

namespace shadelab {

enum class Normals { smooth, flat, file };
enum class Interpolation { phong, gouraud };

struct FilmSettings {
    int width = 512, height = 512;
    int samples = 1;           ///< coverage and depth samples per pixel; shading stays once per pixel and triangle
    glm::dvec3 background{0};  ///< linear RGB
};

struct Camera {
    glm::dvec3 eye, target, up;
    double fov_y;  ///< radians
    double near, far;
    glm::dvec2 shift{0};  ///< moves the picture on the film, in half films: 2/width is a pixel to the right

    glm::dmat4 world_to_clip(double aspect) const;
};

struct Light {
    int kind = 0;                                 ///< its number among the kinds that interface.toml declares
    bool placed = true;                           ///< it has a position
    glm::dvec3 position{0}, direction{0, -1, 0};  ///< direction: unit, the way the light travels
    glm::dvec3 intensity{0}, attenuation{1, 0, 0};
    double hotspot = 0, falloff = 0;  ///< half-angles, radians
    int entry = 0;                    ///< of the file; lights of one entry differ in position alone
    bool grid = false;                ///< it is one of a grid

    /// The members in the order of the Light struct of interface.toml, as plugins and shaders take them.
    std::vector<double> flatten() const;
};

struct Material {
    std::string name, model;
    std::vector<double> parameters;         ///< the members of the model's struct, flattened in the manifest's order
    std::vector<std::string> columns = {};  ///< their names: "m.kd.x"; m is what the model calls its material
};

struct Object {
    std::filesystem::path mesh;
    std::string mesh_where;  ///< "file:line: object[0].mesh", for errors about the mesh file
    int material;
    Normals normals = Normals::smooth;
    Interpolation interpolation = Interpolation::phong;
    glm::dmat4 to_world{1};  ///< translate * rotate * scale
};

struct Scene {
    std::filesystem::path file;
    /// World positions (camera, lights, to_world) are relative to it. 0 unless the scene lies so far from the world's origin that
    /// float32 would lose it; then the camera's target, subtracted in double. A mesh whose file holds the large coordinates
    /// itself needs no more: to_world then moves by -origin, Mesh::origin moves back, and their product in double is as exact
    /// as the file.
    glm::dvec3 origin{0};
    FilmSettings film;
    Camera camera;
    std::vector<std::string> light_kinds;  ///< their names, as interface.toml declares them
    std::vector<Light> lights;
    std::vector<Material> materials;
    std::vector<Object> objects;
};

/// The models that its materials name, each once. Nothing else of the file is checked, but that it is TOML.
std::vector<std::string> scene_models(const std::filesystem::path& file);

/// Throws InputError naming file, line and key.
Scene load_scene(const std::filesystem::path& file, const Manifest& manifest);

}  // namespace shadelab
