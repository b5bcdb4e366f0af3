#include <shadelab/mesh.hpp>

#include <shadelab/error.hpp>

#define TINYOBJLOADER_USE_DOUBLE  // object coordinates may be large; they are rounded once, at the end
#include <tiny_obj_loader.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <map>
#include <sstream>

namespace shadelab {

namespace {

struct Corner {
    int position, normal;  ///< indices into the file's v and vn; normal is -1 where the file gives none
};

std::string one_line(std::string text) {
    std::replace(text.begin(), text.end(), '\n', ' ');
    while (!text.empty() && text.back() == ' ') text.pop_back();
    return text;
}

struct ObjFile {
    std::vector<glm::dvec3> positions, normals;
    std::vector<Corner> corners;  ///< three per triangle
    std::vector<std::string> notes;
    int thin_faces = 0;  ///< faces of fewer than three vertices
};

/// What the loader passes over in silence: it reads "nan", "inf" and words as 0 and leaves out polygons whose indices do not
/// exist. Read here line by line, so that messages can name the line.
struct CheckedStatements {
    std::vector<size_t> not_finite;  ///< vertices, counted from 0
    int thin_faces = 0;
};

CheckedStatements check_statements(std::istream& in, const std::string& file) {
    CheckedStatements out;
    struct Face {
        int line;
        std::string text;
        long positions, normals;  ///< how many stood above it: negative indices count from here
    };
    std::vector<Face> faces;
    long positions = 0, normals = 0;
    std::string line;
    for (int number = 1; std::getline(in, line); ++number) {
        const char* at = line.c_str() + std::min(line.find_first_not_of(" \t"), line.size());
        const auto starts = [&](const char* word, size_t n) {
            return line.compare(size_t(at - line.c_str()), n, word) == 0 && (at[n] == ' ' || at[n] == '\t');
        };
        if (starts("f", 1)) {
            faces.push_back({number, at + 2, positions, normals});
        } else if (starts("vn", 2)) {
            ++normals;
        } else if (starts("v", 1)) {
            bool finite = true;
            at += 2;
            for (int k = 0; k < 3; ++k) {
                char* end;
                finite &= std::isfinite(std::strtod(at, &end));
                if (end == at) throw InputError(file + ":" + std::to_string(number) + ": a vertex takes three numbers");
                at = end;
            }
            if (!finite) out.not_finite.push_back(size_t(positions));
            ++positions;
        }
    }
    for (const Face& face : faces) {
        std::istringstream words(face.text);
        int corners = 0;
        for (std::string word; words >> word && word[0] != '#'; ++corners) {
            const size_t slash = word.rfind('/');
            const bool has_normal = std::count(word.begin(), word.end(), '/') == 2 && slash + 1 < word.size();
            const long p = std::strtol(word.c_str(), nullptr, 10),
                       n = has_normal ? std::strtol(word.c_str() + slash + 1, nullptr, 10) : 1;
            const auto fail = [&](const char* what, long index, long there) {
                throw InputError(file + ":" + std::to_string(face.line) + ": the face refers to " + what + " " +
                                 std::to_string(index) + ", but the file has " + std::to_string(there) +
                                 (index == 0 ? "; they are counted from 1" : ""));
            };
            if (p == 0 || p > positions || -p > face.positions) fail("vertex", p, positions);
            if (has_normal && (n == 0 || n > normals || -n > face.normals)) fail("normal", n, normals);
        }
        out.thin_faces += corners < 3;
    }
    return out;
}

ObjFile read_obj(const std::filesystem::path& file, const std::string& where) {
    std::ifstream in(file);
    if (!in || std::filesystem::is_directory(file))
        throw InputError((where.empty() ? "" : where + ": ") + "the mesh " + file.string() +
                         " cannot be read; does the file exist? (./shadelab doctor says which meshes are there)");
    const CheckedStatements checked = check_statements(in, file.string());
    in.clear();
    in.seekg(0);
    // Material libraries are not even opened: the scene file gives the materials.
    struct IgnoreMaterials : tinyobj::MaterialReader {
        bool seen = false;
        bool operator()(const std::string&, std::vector<tinyobj::material_t>*, std::map<std::string, int>*,
                        std::string*, std::string*) override {
            seen = true;
            return true;
        }
    } materials_reader;
    tinyobj::attrib_t attributes;
    std::vector<tinyobj::shape_t> shapes;
    std::vector<tinyobj::material_t> materials;
    std::string warning, error;
    const bool triangulate = true, default_colors = false;
    if (!tinyobj::LoadObj(&attributes, &shapes, &materials, &warning, &error, &in, &materials_reader, triangulate,
                          default_colors))
        throw InputError(file.string() + ": not a valid OBJ file: " + one_line(error));

    ObjFile obj;
    const auto& v = attributes.vertices;
    const auto& vn = attributes.normals;
    for (size_t i = 0; i + 2 < v.size(); i += 3) obj.positions.emplace_back(v[i], v[i + 1], v[i + 2]);
    for (size_t i = 0; i + 2 < vn.size(); i += 3) obj.normals.emplace_back(vn[i], vn[i + 1], vn[i + 2]);
    for (const size_t vertex : checked.not_finite) obj.positions.at(vertex) = glm::dvec3(std::nan(""));
    obj.thin_faces = checked.thin_faces;
    for (const tinyobj::shape_t& shape : shapes)
        for (const tinyobj::index_t& index : shape.mesh.indices) {
            const bool there = index.vertex_index >= 0 && size_t(index.vertex_index) < obj.positions.size() &&
                               index.normal_index < int(obj.normals.size());
            if (!there) throw InputError(file.string() + ": a face refers to a vertex or normal that is not there");
            obj.corners.push_back({index.vertex_index, index.normal_index});
        }
    if (obj.corners.empty()) throw InputError(file.string() + ": holds no faces");
    if (materials_reader.seen)
        obj.notes.push_back(file.filename().string() + ": materials (mtllib) ignored; the scene file gives them");
    return obj;
}

bool finite(glm::dvec3 p) { return std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z); }

/// Not normalised; its length is twice the area. The origin is subtracted in double, so large coordinates do not tilt it.
glm::dvec3 area_normal(const ObjFile& obj, size_t triangle) {
    const Corner* corner = &obj.corners[3 * triangle];
    const glm::dvec3 a = obj.positions[corner[0].position];
    return glm::cross(obj.positions[corner[1].position] - a, obj.positions[corner[2].position] - a);
}

void drop_degenerate(ObjFile& obj, int& dropped) {
    std::vector<Corner> kept;
    for (size_t t = 0; 3 * t < obj.corners.size(); ++t) {
        const glm::dvec3 normal = area_normal(obj, t);
        const bool drawable = finite(normal) && glm::dot(normal, normal) > 0;
        if (drawable)
            kept.insert(kept.end(), &obj.corners[3 * t], &obj.corners[3 * t] + 3);
        else
            ++dropped;
    }
    obj.corners.swap(kept);
}

/// The angle-weighted sums of face normals at each position, and the sums of the weights.
void accumulate_normals(const ObjFile& obj, std::vector<glm::dvec3>& sums, std::vector<double>& weights) {
    sums.assign(obj.positions.size(), glm::dvec3(0));
    weights.assign(obj.positions.size(), 0);
    for (size_t t = 0; 3 * t < obj.corners.size(); ++t) {
        const glm::dvec3 face = glm::normalize(area_normal(obj, t));
        for (int k = 0; k < 3; ++k) {
            const int p = obj.corners[3 * t + k].position;
            const glm::dvec3 a = obj.positions[obj.corners[3 * t + (k + 1) % 3].position] - obj.positions[p];
            const glm::dvec3 b = obj.positions[obj.corners[3 * t + (k + 2) % 3].position] - obj.positions[p];
            // atan2 and not acos: exact for the thin angles of slivers, where a cosine has no digits left.
            const double angle = std::atan2(glm::length(glm::cross(a, b)), glm::dot(a, b));
            sums[p] += angle * face;
            weights[p] += angle;
        }
    }
}

}  // namespace

Mesh load_mesh(const std::filesystem::path& file, Normals mode, const std::string& where) {
    ObjFile obj = read_obj(file, where);
    Mesh mesh;
    mesh.notes = obj.notes;
    mesh.dropped_triangles = obj.thin_faces;
    drop_degenerate(obj, mesh.dropped_triangles);
    if (mesh.dropped_triangles > 0)
        mesh.notes.push_back(file.filename().string() + ": " + std::to_string(mesh.dropped_triangles) +
                             " triangles without area or with coordinates that are not finite were left out");

    const auto lacks_normal = [&](const Corner& c) {
        return c.normal < 0 || !(glm::length(obj.normals[c.normal]) > 0);
    };
    if (mode == Normals::file && std::any_of(obj.corners.begin(), obj.corners.end(), lacks_normal)) {
        mesh.notes.push_back(file.filename().string() +
                             ": normals = \"file\", but not every face has some; smooth ones are used instead");
        mode = Normals::smooth;
    }

    std::vector<glm::dvec3> sums;
    std::vector<double> weights;
    std::vector<char> cancelled(obj.positions.size(), false);
    if (mode == Normals::smooth) {
        accumulate_normals(obj, sums, weights);
        for (size_t p = 0; p < sums.size(); ++p) {
            // Below this the direction of the sum is rounding noise: float32 inputs carry about 1e-7.
            cancelled[p] = weights[p] > 0 && glm::length(sums[p]) < 1e-6 * weights[p];
            mesh.cancelled_normals += cancelled[p];
        }
    }

    // One output vertex per distinct (position, normal); a face normal of its own is told apart by the triangle's number.
    std::map<std::pair<int, int64_t>, uint32_t> vertex_of_key;
    std::vector<int64_t> shared(obj.positions.size(), -1);
    for (size_t t = 0; 3 * t < obj.corners.size(); ++t) {
        glm::vec3 corner_normals[3];
        for (int k = 0; k < 3; ++k) {
            const Corner corner = obj.corners[3 * t + k];
            const bool own = mode == Normals::flat || (mode == Normals::smooth && cancelled[corner.position]);
            const bool from_file = !own && mode == Normals::file;
            uint32_t vertex;
            bool fresh = false;
            if (!own && !from_file) {  // the common case, without a map
                fresh = shared[corner.position] < 0;
                if (fresh) shared[corner.position] = int64_t(mesh.positions.size());
                vertex = uint32_t(shared[corner.position]);
            } else {
                const int64_t key = own ? -1 - int64_t(t) : corner.normal;
                const auto [entry, inserted] =
                    vertex_of_key.try_emplace({corner.position, key}, uint32_t(mesh.positions.size()));
                fresh = inserted;
                vertex = entry->second;
            }
            if (fresh) {
                const glm::dvec3 normal = own         ? area_normal(obj, t)
                                          : from_file ? obj.normals[corner.normal]
                                                      : sums[corner.position];
                mesh.positions.push_back(glm::vec3(obj.positions[corner.position]));
                mesh.normals.push_back(glm::vec3(glm::normalize(normal)));
            }
            mesh.indices.push_back(vertex);
            corner_normals[k] = mesh.normals[vertex];
        }
        for (int k = 0; k < 3; ++k)
            mesh.opposing_normals |= glm::dot(corner_normals[k], corner_normals[(k + 1) % 3]) < 0;
    }
    if (mesh.cancelled_normals > 0)
        mesh.notes.push_back(file.filename().string() + ": " + std::to_string(mesh.cancelled_normals) +
                             " vertices whose face normals cancel use the face normals");
    return mesh;
}

bool normals_can_cancel(const Mesh& mesh, const glm::dmat4& to_world) {
    // A transform that changes angles can turn harmless normals into opposing ones.
    const glm::dmat3 linear(to_world), gram = glm::transpose(linear) * linear;
    const double off = std::abs(gram[0][1]) + std::abs(gram[0][2]) + std::abs(gram[1][2]) +
                       std::abs(gram[0][0] - gram[1][1]) + std::abs(gram[0][0] - gram[2][2]);
    return mesh.opposing_normals || off > 1e-9 * gram[0][0];
}

}  // namespace shadelab
